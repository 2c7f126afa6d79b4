"""Forward kinematics of arm and gripper, the joints' axes, and the gripper's Jacobian."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float

from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.robot.model import Arm, Robot


def forward_kinematics(arm: Arm, q: Float[Array, " n"]) -> Float[Array, "n+2 7"]:
    """Poses of links 0…n and of the gripper frame in the world, by the product of exponentials in the joint frames.

    Args:
        arm: the chain.
        q: (n,) joint positions, radians.

    Returns:
        (n + 2, 7) wxyz_xyz: link 0, links 1…n, gripper frame. Metres.
    """

    # Scalars in a scan: over a batch ten times faster than 3×3 matrix products, and quick to compile.
    def advance(pose: _Motion, joint: tuple[Array, Array, Array]) -> tuple[_Motion, Float[Array, " 7"]]:
        origin, axis, angle = joint
        rotation, shift = _compose(pose, _motion(origin))
        sine = jnp.sin(0.5 * angle)
        rotation = _hamilton(rotation, (jnp.cos(0.5 * angle), sine * axis[0], sine * axis[1], sine * axis[2]))
        return (rotation, shift), jnp.stack([*rotation, *shift])

    base = jnp.asarray(arm.base, float)
    joints = (jnp.asarray(arm.origins, float), jnp.asarray(arm.axes, float), q)
    last, links = jax.lax.scan(advance, _motion(base), joints)
    rotation, shift = _compose(last, _motion(jnp.asarray(arm.tool, float)))
    return jnp.concatenate([base[None], links, jnp.stack([*rotation, *shift])[None]])


_Motion = tuple[tuple[Array, ...], tuple[Array, ...]]
"""A pose as scalars: unit quaternion (w, x, y, z) and translation (x, y, z)."""


def _motion(pose: Float[Array, " 7"]) -> _Motion:
    return tuple(pose[i] for i in range(4)), tuple(pose[i] for i in range(4, 7))


def _hamilton(a: tuple[Array, ...], b: tuple[Array, ...]) -> tuple[Array, ...]:
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def _compose(a: _Motion, b: _Motion) -> _Motion:
    (w, x, y, z), shift = a
    vx, vy, vz = b[1]
    tx, ty, tz = 2 * (y * vz - z * vy), 2 * (z * vx - x * vz), 2 * (x * vy - y * vx)
    turned = (vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx)
    return _hamilton(a[0], b[0]), tuple(s + t for s, t in zip(shift, turned, strict=True))


def robot_bodies(robot: Robot) -> ConvexBody:
    """All bodies of the robot stacked: links, palm, fingers (the numbering of ``Robot.self_pairs``)."""
    return ConvexBody.concatenate([robot.links, robot.gripper.palm, robot.gripper.fingers])


def body_poses(robot: Robot, q: Float[Array, " n"], theta: Float[Array, ""]) -> Float[Array, "B+P+F 7"]:
    """World poses (B + P + F, 7), wxyz_xyz in metres, of all bodies in the order of `robot_bodies`.

    Args:
        robot: the robot.
        q: (n,) joint positions, radians.
        theta: () finger coordinate θ.
    """
    frames = forward_kinematics(robot.arm, q)
    palm = jnp.broadcast_to(frames[-1], (robot.gripper.palm.batch_size, 7))
    fingers = (jaxlie.SE3(frames[-1]) @ jaxlie.SE3(robot.gripper.finger_motion(theta))).wxyz_xyz
    return jnp.concatenate([frames[robot.link_of], palm, fingers])


def pose_error(pose: Float[Array, " 7"], target: Float[Array, " 7"]) -> Float[Array, " 6"]:
    """Translation (metres) and rotation vector (radians), in world axes, that take ``pose`` to ``target``."""
    turn = (jaxlie.SO3(target[:4]) @ jaxlie.SO3(pose[:4]).inverse()).log()
    return jnp.concatenate([target[4:] - pose[4:], turn])


class JointAxes(NamedTuple):
    """The joints' axes in the world.

    Attributes:
        axis: (…, n, 3) unit vectors.
        point: (…, n, 3) a point on each axis, metres.
    """

    axis: Float[Array, "*N n 3"] | Float[np.ndarray, "*N n 3"]
    point: Float[Array, "*N n 3"] | Float[np.ndarray, "*N n 3"]


def joint_axes(arm: Arm, frames: Float[Array, "*N n+2 7"]) -> JointAxes:
    """The joints' axes, from the frames (…, n + 2, 7) of `forward_kinematics`."""
    joints = frames[..., 1:-1, :]
    return JointAxes(jaxlie.SO3(joints[..., :4]) @ arm.axes, joints[..., 4:])


def gripper_jacobian(arm: Arm, frames: Float[Array, "n+2 7"]) -> Float[Array, "6 n"]:
    """Derivative of the gripper frame's position and rotation (world axes) by the joints, from `forward_kinematics`."""
    axis, point = joint_axes(arm, frames)
    return jnp.concatenate([jnp.cross(axis, frames[-1, 4:] - point), axis], axis=1).T
