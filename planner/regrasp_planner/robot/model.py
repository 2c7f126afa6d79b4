"""Robots in the planner: a serial arm, a gripper whose two fingers are driven together, and convex bodies on both."""

from __future__ import annotations

from dataclasses import dataclass, field

import jax
import jaxlie
import numpy as np
from jaxtyping import Array, Float, Int

from regrasp_planner.geometry.support import ConvexBody


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Arm:
    """Serial chain of n revolute joints.

    Link 0 is the base; link i (1…n) moves with joint i. A link's frame is the frame of its joint.

    Attributes:
        origins: (n, 7) pose (wxyz, xyz) of joint frame i in the frame of link i−1, at q = 0. Metres.
        axes: (n, 3) unit rotation axis of joint i in its own frame.
        lower, upper: (n,) position limits, radians.
        max_velocity: (n,) rad/s.
        max_acceleration: (n,) rad/s².
        base: (7,) pose of link 0 in the world.
        tool: (7,) pose of the gripper frame in the frame of link n.
        joint_names: names of the joints, for messages.
    """

    origins: Float[Array, "n 7"]
    axes: Float[Array, "n 3"]
    lower: Float[Array, " n"]
    upper: Float[Array, " n"]
    max_velocity: Float[Array, " n"]
    max_acceleration: Float[Array, " n"]
    base: Float[Array, " 7"]
    tool: Float[Array, " 7"]
    joint_names: tuple[str, ...] = field(metadata={"static": True})

    @property
    def dof(self) -> int:
        """Number of joints n."""
        return self.axes.shape[0]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Gripper:
    """Two-finger gripper: one scalar, the finger coordinate θ, drives both fingers.

    The origin of the gripper frame is the grasp centre between the finger pads (the tool centre point). Finger k moves
    in the gripper frame by ``exp(θ · screws[k])`` from its pose at θ = 0. The twist ``screws[k]`` (linear, angular) is
    a translation for a sliding finger, and a rotation about a hinge for a swinging jaw.

    Attributes:
        palm: (P, …) bodies fixed to the gripper frame, stacked.
        fingers: (F, …) bodies that move with a finger, stacked, in the gripper frame at θ = 0.
        finger_of: (F,) finger (0 or 1) that each of ``fingers`` belongs to.
        contact: (2,) indices into ``fingers``: the pads of finger 0 and finger 1, which touch the target.
        screws: (2, 6) twist (v, ω) per unit θ of each finger in the gripper frame.
        lower, upper: () limits of θ: metres for sliding fingers, where θ is the travel of each finger and the opening
            is 2θ; radians for jaws. Larger θ is wider.
        width_axis: (3,) unit axis Z_G along which the fingers close, in the gripper frame.
        approach_axis: (3,) unit axis pointing out of the palm towards the object, in the gripper frame.
        max_opening: () widest gap between the pads, metres.
    """

    palm: ConvexBody
    fingers: ConvexBody
    finger_of: Int[Array, " F"]
    contact: Int[Array, " 2"]
    screws: Float[Array, "2 6"]
    lower: Float[Array, ""]
    upper: Float[Array, ""]
    width_axis: Float[Array, " 3"]
    approach_axis: Float[Array, " 3"]
    max_opening: Float[Array, ""]

    def finger_motion(self, theta: Float[Array, ""]) -> Float[Array, "F 7"]:
        """Motion (F, 7), wxyz_xyz, of each finger body from θ = 0 to ``theta`` in the gripper frame: exp(θ ξ)."""
        return jaxlie.SE3.exp(theta * self.screws).wxyz_xyz[self.finger_of]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Robot:
    """An arm with a gripper, and the convex bodies on its links.

    Attributes:
        arm: the serial chain.
        gripper: fingers and palm.
        links: (B, …) bodies on the arm's links, stacked, in their link's frame.
        link_of: (B,) link (0…n) each body is fixed to.
        self_pairs: (S, 2) pairs to check for self-collision. Indices count the bodies of ``links`` first (0…B−1),
            then ``gripper.palm`` (B…B+P−1), then ``gripper.fingers``.
        home: (n,) rest configuration, away from joint limits, radians.
        name: for messages.
        unit: metres per unit of length in this description, for messages; see `regrasp_planner.stages.scale`.
    """

    arm: Arm
    gripper: Gripper
    links: ConvexBody
    link_of: Int[Array, " B"]
    self_pairs: Int[Array, "S 2"]
    home: Float[Array, " n"]
    name: str = field(metadata={"static": True})
    unit: float = field(default=1.0, metadata={"static": True})

    @property
    def body_count(self) -> int:
        """Number of bodies B + P + F: on the links, of the palm, and of the fingers."""
        return self.links.batch_size + self.gripper.palm.batch_size + self.gripper.fingers.batch_size


def check_configuration(robot: Robot, q: np.ndarray) -> None:
    """Raise ``ValueError`` if q has the wrong shape, is not finite, or is outside the limits by more than 1e-6 rad."""
    q = np.asarray(q, float)
    if q.shape != (robot.arm.dof,):
        raise ValueError(f"configuration has shape {q.shape}; robot {robot.name!r} needs ({robot.arm.dof},)")
    if not np.isfinite(q).all():
        raise ValueError(f"configuration of robot {robot.name!r} is not finite: {q}")
    low, high = np.asarray(robot.arm.lower), np.asarray(robot.arm.upper)
    for i in np.flatnonzero((q < low - 1e-6) | (q > high + 1e-6)):
        raise ValueError(
            f"joint {robot.arm.joint_names[i]!r} is at {q[i]:.4f} rad, outside its limits [{low[i]:.4f}, {high[i]:.4f}]"
        )
