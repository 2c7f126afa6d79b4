"""A 21 t excavator with a tiltrotator and a two-jaw stone grapple, as a MuJoCo specification."""

from __future__ import annotations

from importlib.resources import files
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from jaxtyping import Float

from regrasp_gym.robots.excavator_looks import add_looks

if TYPE_CHECKING:
    from regrasp_planner import Robot

ARM_JOINTS = ("swing", "boom", "arm", "pitch", "tilt", "rotate")
"""Names of the joints from the ground to the grapple."""

FINGER_JOINTS = ("jaw_left", "jaw_right")
"""Names of the two jaw hinges, driven as one by the actuator ``gripper``."""

ARM_ACTUATORS = tuple(f"actuator_{joint}" for joint in ARM_JOINTS)
"""Names of the position actuators of `ARM_JOINTS` (ctrl in radians)."""

GRIPPER_ACTUATOR = "gripper"
"""Name of the grapple's position actuator: ctrl is the angle θ of each jaw, see `THETA_RANGE`."""

TCP_SITE = "tcp"
"""Site at the grasp centre: +z out of the palm, the jaws close along ±y."""

PADS = ("left_pad", "right_pad")
"""Geoms of the parts that hold: a round bar across the tip of each jaw, along the tool's x axis."""

HOME = np.array([0.0, -0.8099, 1.551, 0.8296, 0.0, 0.0])
"""(6,) ready configuration, radians: facing +x, the grapple pointing straight down, `TCP_SITE` near (6.3, 0, 2.2)."""

THETA_RANGE = (-0.4237, 0.2014)
"""Least and greatest jaw angle, radians: 0.10 m and 1.20 m between the pads, 0.84 m + 1.8 m sin θ in general.

From one to the other takes 1.9 s.
"""

MAX_VELOCITY = np.array([0.5, 0.25, 0.5, 0.6, 0.4, 0.8])
"""(6,) joint velocities of a careful operator, rad/s.

About half of what a Hitachi ZX200 does (pwri-opera: swing 1.1, boom 0.45, arm 1.1, bucket 1.1 rad/s); estimates for the
tiltrotator.
"""

MAX_ACCELERATION = np.array([0.175, 0.35, 1.45, 2.1, 1.0, 2.0])
"""(6,) joint accelerations of a careful operator, rad/s².

Half of what a Hitachi ZX200 does (pwri-opera: swing 0.35, boom 0.7, arm 2.9, bucket 4.2 rad/s²); estimates for the
tiltrotator. Stretched out with a 1 t stone, 0.175 rad/s² takes two thirds of the swing motor's torque. Set points that
jump to `MAX_VELOCITY` at once ask for more than the motor has, and the house overshoots by up to half a radian.
"""

PAIR_REACH = 1.0
"""Bodies of the machine that never come nearer than this to each other are no self-collision pair, metres."""


def build_spec() -> mujoco.MjSpec:
    """A new specification of the machine alone, standing on level ground z = 0 with its swing axis at the origin.

    Bodies ``chassis`` (fixed to the world), ``house``, ``boom``, ``arm``, ``tool_pitch``, ``tool_tilt``,
    ``tool_rotate``, ``gripper`` (the palm), ``left_jaw``, ``right_jaw``; joints `ARM_JOINTS` and `FINGER_JOINTS`;
    position actuators `ARM_ACTUATORS` (force limits 74, 370, 190, 73, 40 and 9 kN·m) and `GRIPPER_ACTUATOR` (40 kN at
    each pad); site `TCP_SITE`; camera ``cab``, the operator's view. Collision geoms are in group 3, the geoms that are
    seen in group 2. What touches a stone for `PADS` are polyhedra in their place, ``left_bite`` and ``right_bite`` in
    group 4. All bodies are gravity-compensated. Physics options are left at their defaults: see
    `regrasp_gym.simulation.physics.configure`.
    """
    xml = files("regrasp_gym.robots").joinpath("excavator.xml").read_text(encoding="utf-8")
    spec = mujoco.MjSpec.from_string(xml)
    spec.add_mesh(name="bite").uservert = _pad_vertices().ravel()
    add_looks(spec)
    return spec


def _pad_vertices() -> Float[np.ndarray, "N 3"]:
    """Corners of the polyhedron that stands for a pad in contacts: the capsule with 20 sides and blunt ends."""
    turn = 2 * np.pi * np.arange(20) / 20
    around = np.column_stack([np.zeros(20), np.cos(turn), np.sin(turn)])
    bulge = np.radians([0.0, 30.0, 58.0])
    half = 0.12 + 0.1 * np.sin(bulge)
    rings = [
        around * 0.1 * np.cos(b) + [side * x, 0.0, 0.9] for side in (-1, 1) for b, x in zip(bulge, half, strict=True)
    ]
    return np.concatenate(rings)


def planner_robot(model: mujoco.MjModel | None = None) -> Robot:
    """The excavator as the planner sees it.

    Args:
        model: a compiled model that holds the excavator under the names of `build_spec`; by default it alone.
    """
    # Imported here because it loads JAX, which the physics alone does not need.
    from regrasp_gym.robots.planner_robot import robot_from_model

    return robot_from_model(
        build_spec().compile() if model is None else model,
        name="excavator",
        base="chassis",
        joints=ARM_JOINTS,
        tool_site=TCP_SITE,
        finger_joints=FINGER_JOINTS,
        pads=PADS,
        max_velocity=MAX_VELOCITY,
        max_acceleration=MAX_ACCELERATION,
        home=HOME,
        reach=PAIR_REACH,
    )
