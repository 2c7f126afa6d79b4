"""A scenario of pick-and-place with regrasp, as data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from regrasp_gym.rendering.setting import TABLE_TOP, Camera, Setting
from regrasp_gym.robots.setup import RobotSetup
from regrasp_gym.scenes.scene import Scene


@dataclass(frozen=True, eq=False)
class Scenario:
    """A robot, its scenes and the environment's conventions.

    Attributes:
        robot: the robot.
        make_scene: (seed, config) → scene; None is the default config.
        control_period: seconds per environment step.
        tolerance: when the target counts as placed.
        arrival: largest joint error of a finished motion, radians.
        pace: time to come to rest in units of that on a table top: gravity moves objects ten times as large √10 times
            as slowly.
        max_others: number of objects besides the target that observations have room for.
        translation_step: largest move of the gripper per step under ``ee_delta``, metres.
        rotation_step: largest turn of the gripper per step under ``ee_delta``, radians.
        cameras: cameras fixed in the world; the robot's specification may have more.
        pixels: names of the cameras in observations with pixels.
        floor_height: height of the floor, metres.
        setting: light and surroundings.
        held: whether the target has to be held at the goal, instead of released there.
    """

    robot: RobotSetup
    make_scene: Callable[[int, Any], Scene]
    control_period: float
    tolerance: Tolerance
    arrival: float
    pace: float
    max_others: int
    translation_step: float
    rotation_step: float
    cameras: tuple[Camera, ...]
    pixels: tuple[str, ...]
    floor_height: float
    setting: Setting = TABLE_TOP
    held: bool = False


@dataclass(frozen=True)
class Tolerance:
    """When the target counts as placed, and the lengths of the dense reward.

    Attributes:
        position: largest distance from the goal, metres.
        rotation: largest angle from the goal, radians.
        speed: largest speed of a target at rest, m/s.
        turn_rate: largest angular speed of a target at rest, rad/s.
        lever: metres per radian of misalignment in the dense reward: half the size of a larger object.
        length: distance at which the terms of the dense reward fall to 1 − tanh 1 = 24 %, metres.
    """

    position: float = 0.025
    rotation: float = float(np.deg2rad(15))
    speed: float = 0.01
    turn_rate: float = 0.2
    lever: float = 0.1
    length: float = 0.2
