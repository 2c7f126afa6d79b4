"""How the environments and the planner drive a robot: its names in MuJoCo and its limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from regrasp_planner import Robot


@dataclass(frozen=True, eq=False)
class RobotSetup:
    """Names of a robot's parts in its MuJoCo specification, and its limits.

    Attributes:
        name: name of the robot, used in messages.
        build_spec: builds a new specification of the robot alone.
        base: body of link 0, fixed to the world.
        arm_joints: the n hinge joints, base to wrist. Every joint must sit at the origin of its body.
        arm_actuators: the n actuators of these joints; ctrl is the joint's position, radians.
        finger_joints: slide or hinge joint of each finger, both at the finger coordinate θ. The last link must carry
            the fingers.
        pads: geom of each finger that touches the target.
        gripper_actuator: the actuator of the fingers; ctrl is θ.
        tcp_site: site at the grasp centre; its frame is the gripper frame, +z out of the palm, with the fingers closing
            along ±y.
        home: (n,) configuration at the start of an episode, radians.
        max_velocity: (n,) limit of the commanded joint motion, rad/s.
        max_acceleration: (n,) limit of the commanded joint motion, rad/s².
        theta_range: least and greatest θ; greater is wider. Metres for sliding fingers, radians for jaws.
        pair_distance: two bodies of the robot form a self-collision pair if they come this near, metres.
    """

    name: str
    build_spec: Callable[[], mujoco.MjSpec]
    base: str
    arm_joints: tuple[str, ...]
    arm_actuators: tuple[str, ...]
    finger_joints: tuple[str, str]
    pads: tuple[str, str]
    gripper_actuator: str
    tcp_site: str
    home: Float[np.ndarray, " n"]
    max_velocity: Float[np.ndarray, " n"]
    max_acceleration: Float[np.ndarray, " n"]
    theta_range: tuple[float, float]
    pair_distance: float = 0.15

    def planner_robot(self, model: mujoco.MjModel | None = None) -> Robot:
        """The planner's robot, read from a compiled model, so that physics and planner cannot differ.

        Args:
            model: a compiled model that contains the robot; the robot alone by default.
        """
        # Imported here because it loads JAX, which the physics does not need.
        from regrasp_gym.robots.planner_robot import robot_from_model

        return robot_from_model(self.build_spec().compile() if model is None else model, self)
