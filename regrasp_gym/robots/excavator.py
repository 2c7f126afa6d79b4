"""A 21 t excavator with a tiltrotator and a two-jaw stone grapple, as a MuJoCo specification."""

from __future__ import annotations

from importlib.resources import files

import mujoco
import numpy as np
from jaxtyping import Float

from regrasp_gym.robots.excavator_looks import excavator_looks
from regrasp_gym.robots.looks import add_looks
from regrasp_gym.robots.setup import RobotSetup


def build_spec() -> mujoco.MjSpec:
    """A new specification of the machine alone, standing on level ground z = 0 with its swing axis at the origin.

    Bodies ``chassis`` (fixed to the world), ``house``, ``boom``, ``arm``, ``tool_pitch``, ``tool_tilt``,
    ``tool_rotate``, ``gripper`` (the palm), ``left_jaw``, ``right_jaw``; joints, actuators and site as in `EXCAVATOR`
    (force limits 74, 370, 190, 73, 40 and 9 kN·m, and 40 kN at each pad); camera ``cab``, the operator's view.
    Collision geoms are in group 3, visible geoms in group 2. Stones touch the polyhedra ``left_bite`` and
    ``right_bite`` (group 4) in place of the pads. All bodies are gravity-compensated. Physics options are left at their
    defaults: see `regrasp_gym.simulation.physics.configure`.
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


_JOINTS = ("swing", "boom", "arm", "pitch", "tilt", "rotate")

EXCAVATOR = RobotSetup(
    name="excavator",
    build_spec=build_spec,
    base="chassis",
    arm_joints=_JOINTS,
    arm_actuators=tuple(f"actuator_{joint}" for joint in _JOINTS),
    finger_joints=("jaw_left", "jaw_right"),
    # A round bar across the tip of each jaw, along the tool's x axis.
    pads=("left_pad", "right_pad"),
    gripper_actuator="gripper",
    tcp_site="tcp",
    # Facing +x, the grapple pointing straight down, the grasp centre near (6.3, 0, 2.2).
    home=np.array([0.0, -0.8099, 1.551, 0.8296, 0.0, 0.0]),
    # A careful operator: about half of what a Hitachi ZX200 does (pwri-opera: swing 1.1, boom 0.45, arm 1.1, bucket
    # 1.1 rad/s and 0.35, 0.7, 2.9, 4.2 rad/s²); estimates for the tiltrotator. Stretched out with a 1 t stone,
    # 0.175 rad/s² takes two thirds of the swing motor's torque. Set points that jump to full velocity at once exceed
    # it, and the house overshoots by up to half a radian.
    max_velocity=np.array([0.5, 0.25, 0.5, 0.6, 0.4, 0.8]),
    max_acceleration=np.array([0.175, 0.35, 1.45, 2.1, 1.0, 2.0]),
    # 0.10 m to 1.20 m between the pads, 0.84 m + 1.8 m sin θ in general. Full travel takes 1.9 s.
    theta_range=(-0.4237, 0.2014),
    pair_distance=1.0,
)
"""The excavator as environments and planner drive it; θ is the angle of each jaw, radians."""
