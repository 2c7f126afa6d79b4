"""The Franka Emika Panda with its hand, as a MuJoCo specification."""

from __future__ import annotations

from importlib.resources import files

import mujoco
import numpy as np

from regrasp_gym.robots.looks import add_looks
from regrasp_gym.robots.panda_looks import panda_looks
from regrasp_gym.robots.setup import RobotSetup


def build_spec() -> mujoco.MjSpec:
    """A new specification of the robot alone, with its base ``link0`` at the world's origin.

    Bodies ``link0`` … ``link7``, ``hand``, ``left_finger``, ``right_finger``; joints, actuators and site as in `PANDA`
    (force limits 87 and 12 N·m, and 70 N at each pad); camera ``wrist``. Collision geoms are in group 3, visible geoms
    in group 2. All bodies are gravity-compensated. Physics options are left at their defaults: see
    `regrasp_gym.simulation.physics.configure`.
    """
    xml = files("regrasp_gym.robots").joinpath("panda.xml").read_text(encoding="utf-8")
    spec = mujoco.MjSpec.from_string(xml)
    add_looks(spec, panda_looks())
    return spec


PANDA = RobotSetup(
    name="panda",
    build_spec=build_spec,
    base="link0",
    arm_joints=tuple(f"joint{i}" for i in range(1, 8)),
    arm_actuators=tuple(f"actuator{i}" for i in range(1, 8)),
    finger_joints=("finger_joint1", "finger_joint2"),
    pads=("left_pad_c", "right_pad_c"),
    gripper_actuator="gripper",
    tcp_site="tcp",
    # The usual ready configuration: hand level, pointing down.
    home=np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4]),
    # Franka, "Robot and interface specifications".
    max_velocity=np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61]),
    max_acceleration=np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0]),
    theta_range=(0.0, 0.04),
)
"""The Panda as environments and planner drive it; θ is the travel of each finger, metres."""
