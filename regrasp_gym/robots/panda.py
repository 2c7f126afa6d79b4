"""The Franka Emika Panda with its hand, as a MuJoCo specification."""

from __future__ import annotations

from importlib.resources import files

import mujoco
import numpy as np

from regrasp_gym.robots.looks import add_looks
from regrasp_gym.robots.panda_looks import panda_looks
from regrasp_gym.robots.setup import RobotSetup

ARM_JOINTS = tuple(f"joint{i}" for i in range(1, 8))
"""Names of the arm's joints, base to wrist."""

FINGER_JOINTS = ("finger_joint1", "finger_joint2")
"""Names of the two finger slides, driven as one by the actuator ``gripper``."""

ARM_ACTUATORS = tuple(f"actuator{i}" for i in range(1, 8))
"""Names of the arm's position actuators (ctrl in radians)."""

GRIPPER_ACTUATOR = "gripper"
"""Name of the gripper's position actuator: ctrl is the travel θ of each finger, 0 (closed) to 0.04 m."""

TCP_SITE = "tcp"
"""Site at the grasp centre: +z out of the palm, the fingers close along ±y."""

PADS = ("left_pad_c", "right_pad_c")
"""Geoms of the finger tips that touch the target."""

HOME = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])
"""(7,) the usual ready configuration, radians: hand level, pointing down."""

OPEN_THETA = 0.04
"""Finger travel of the open gripper, metres."""

MAX_VELOCITY = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
"""(7,) joint velocity limits, rad/s. Franka, "Robot and interface specifications"."""

MAX_ACCELERATION = np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])
"""(7,) joint acceleration limits, rad/s². Franka, "Robot and interface specifications"."""


def build_spec() -> mujoco.MjSpec:
    """A new specification of the robot alone, with its base ``link0`` at the world's origin.

    Bodies ``link0`` … ``link7``, ``hand``, ``left_finger``, ``right_finger``; joints `ARM_JOINTS` and `FINGER_JOINTS`;
    position actuators `ARM_ACTUATORS` (force limits 87 and 12 N·m) and `GRIPPER_ACTUATOR` (70 N at each pad); site
    `TCP_SITE`; camera ``wrist``. Collision geoms are in group 3, visible geoms in group 2. All bodies are
    gravity-compensated. Physics options are left at their defaults: see `regrasp_gym.simulation.physics.configure`.
    """
    xml = files("regrasp_gym.robots").joinpath("panda.xml").read_text(encoding="utf-8")
    spec = mujoco.MjSpec.from_string(xml)
    add_looks(spec, panda_looks())
    return spec


PANDA = RobotSetup(
    name="panda",
    build_spec=build_spec,
    base="link0",
    arm_joints=ARM_JOINTS,
    arm_actuators=ARM_ACTUATORS,
    finger_joints=FINGER_JOINTS,
    pads=PADS,
    gripper_actuator=GRIPPER_ACTUATOR,
    tcp_site=TCP_SITE,
    home=HOME,
    max_velocity=MAX_VELOCITY,
    max_acceleration=MAX_ACCELERATION,
    theta_range=(0.0, OPEN_THETA),
)
"""The Panda as the environments drive it."""
