"""A 21 t excavator with a tiltrotator and a two-jaw stone grapple, as a MuJoCo specification."""

from __future__ import annotations

from importlib.resources import files

import mujoco
import numpy as np
from jaxtyping import Float

from regrasp_gym.robots.excavator_looks import excavator_looks
from regrasp_gym.robots.looks import add_looks
from regrasp_gym.robots.setup import RobotSetup

ARM_JOINTS = ("swing", "boom", "arm", "pitch", "tilt", "rotate")
"""Names of the joints, chassis to grapple."""

FINGER_JOINTS = ("jaw_left", "jaw_right")
"""Names of the two jaw hinges, driven as one by the actuator ``gripper``."""

ARM_ACTUATORS = tuple(f"actuator_{joint}" for joint in ARM_JOINTS)
"""Names of the position actuators of `ARM_JOINTS` (ctrl in radians)."""

GRIPPER_ACTUATOR = "gripper"
"""Name of the grapple's position actuator: ctrl is the angle θ of each jaw, see `THETA_RANGE`."""

TCP_SITE = "tcp"
"""Site at the grasp centre: +z out of the palm, the jaws close along ±y."""

PADS = ("left_pad", "right_pad")
"""Geoms that hold the target: a round bar across the tip of each jaw, along the tool's x axis."""

HOME = np.array([0.0, -0.8099, 1.551, 0.8296, 0.0, 0.0])
"""(6,) ready configuration, radians: facing +x, the grapple pointing straight down, `TCP_SITE` near (6.3, 0, 2.2)."""

THETA_RANGE = (-0.4237, 0.2014)
"""Least and greatest jaw angle, radians: 0.10 m and 1.20 m between the pads, 0.84 m + 1.8 m sin θ in general.

Full travel takes 1.9 s.
"""

MAX_VELOCITY = np.array([0.5, 0.25, 0.5, 0.6, 0.4, 0.8])
"""(6,) joint velocities of a careful operator, rad/s.

About half those of a Hitachi ZX200 (pwri-opera: swing 1.1, boom 0.45, arm 1.1, bucket 1.1 rad/s); estimates for the
tiltrotator.
"""

MAX_ACCELERATION = np.array([0.175, 0.35, 1.45, 2.1, 1.0, 2.0])
"""(6,) joint accelerations of a careful operator, rad/s².

Half those of a Hitachi ZX200 (pwri-opera: swing 0.35, boom 0.7, arm 2.9, bucket 4.2 rad/s²); estimates for the
tiltrotator. Stretched out with a 1 t stone, 0.175 rad/s² takes two thirds of the swing motor's torque. Set points that
jump to `MAX_VELOCITY` at once exceed it, and the house overshoots by up to half a radian.
"""

PAIR_DISTANCE = 1.0
"""Two bodies of the machine form a self-collision pair if they come this near, metres."""


def build_spec() -> mujoco.MjSpec:
    """A new specification of the machine alone, standing on level ground z = 0 with its swing axis at the origin.

    Bodies ``chassis`` (fixed to the world), ``house``, ``boom``, ``arm``, ``tool_pitch``, ``tool_tilt``,
    ``tool_rotate``, ``gripper`` (the palm), ``left_jaw``, ``right_jaw``; joints `ARM_JOINTS` and `FINGER_JOINTS`;
    position actuators `ARM_ACTUATORS` (force limits 74, 370, 190, 73, 40 and 9 kN·m) and `GRIPPER_ACTUATOR` (40 kN at
    each pad); site `TCP_SITE`; camera ``cab``, the operator's view. Collision geoms are in group 3, visible geoms in
    group 2. Stones touch the polyhedra ``left_bite`` and ``right_bite`` (group 4)
    in place of `PADS`. All bodies are gravity-compensated. Physics options are left at their defaults: see
    `regrasp_gym.simulation.physics.configure`.
    """
    xml = files("regrasp_gym.robots").joinpath("excavator.xml").read_text(encoding="utf-8")
    spec = mujoco.MjSpec.from_string(xml)
    spec.add_mesh(name="bite").uservert = _pad_vertices().ravel()
    add_looks(spec, excavator_looks())
    return spec


def _pad_vertices() -> Float[np.ndarray, "N 3"]:
    """Corners of the polyhedron that replaces a pad in contacts: the capsule with 20 sides and blunt ends."""
    turn = 2 * np.pi * np.arange(20) / 20
    around = np.column_stack([np.zeros(20), np.cos(turn), np.sin(turn)])
    bulge = np.radians([0.0, 30.0, 58.0])
    half = 0.12 + 0.1 * np.sin(bulge)
    rings = [
        around * 0.1 * np.cos(b) + [side * x, 0.0, 0.9] for side in (-1, 1) for b, x in zip(bulge, half, strict=True)
    ]
    return np.concatenate(rings)


EXCAVATOR = RobotSetup(
    name="excavator",
    build_spec=build_spec,
    base="chassis",
    arm_joints=ARM_JOINTS,
    arm_actuators=ARM_ACTUATORS,
    finger_joints=FINGER_JOINTS,
    pads=PADS,
    gripper_actuator=GRIPPER_ACTUATOR,
    tcp_site=TCP_SITE,
    home=HOME,
    max_velocity=MAX_VELOCITY,
    max_acceleration=MAX_ACCELERATION,
    theta_range=THETA_RANGE,
    pair_distance=PAIR_DISTANCE,
)
"""The excavator as the environments drive it."""
