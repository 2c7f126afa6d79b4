"""Compiled programs of `PairDistancer`: lower bounds of the distances of all pairs of bodies, distances of a few."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float, Int

from regrasp_planner.collision.model import CollisionArrays, CollisionModel, body_frames
from regrasp_planner.geometry.boxes import box_bounds
from regrasp_planner.geometry.distance import hull_gap, separation
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.robot.kinematics import JointAxes, forward_kinematics, joint_axes

_ROUNDING = 2e-6
"""What single precision may get wrong in a lower bound, metres, for a workspace of a few metres."""


def chain_of_pairs(model: CollisionModel) -> tuple[Float[np.ndarray, "P n"], Int[np.ndarray, " P"]]:
    """Signs (P, n) with which each joint moves the second body of a pair away from the first, and the outer body.

    −1: the joint moves only the first body; +1: only the second; 0: both or none. The outer body (P,) is the one
    further down the chain: the pair's relative motion is its motion seen from the other.
    """
    dof = model.arrays.robot.arm.dof
    pairs = model.pairs
    first, second = np.asarray(model.arrays.mover)[pairs].T
    number = np.arange(1, dof + 1)
    sign = (number <= second[:, None]).astype(float) - (number <= first[:, None]).astype(float)
    return sign, np.where(first >= second, pairs[:, 0], pairs[:, 1]).astype(np.int32)


@jax.jit
def bound_pairs(
    arrays: CollisionArrays, q: Float[Array, "N n"], theta: Float[Array, ""]
) -> tuple[Float[Array, "P N"], Float[Array, "N M n"], Float[Array, "N M 7"], JointAxes]:
    """Lower bounds of the distances of all P pairs, in N configurations.

    Everything per pair is single precision, with configurations last: memory traffic is what it costs.

    Args:
        arrays: the collision model.
        q: (N, n) radians.
        theta: finger coordinate.

    Returns:
        (P, N) bounds, metres; (N, M, n) largest distance of a body's points from each joint's axis, metres; (N, M, 7)
        world poses of the bodies; the joints' axes.
    """
    poses = jax.vmap(lambda one: body_frames(arrays, one, theta))(q)
    axis, point = joint_axes(arrays.robot.arm, jax.vmap(lambda one: forward_kinematics(arrays.robot.arm, one))(q))
    centers = jaxlie.SE3(poses) @ arrays.boxes.center[None]
    extent = jnp.linalg.norm(arrays.boxes.half, axis=-1) + arrays.bodies.radius
    arm = centers[:, :, None, :] - point[:, None]
    along = (arm * axis[:, None]).sum(-1, keepdims=True) * axis[:, None]
    radius = jnp.linalg.norm(arm - along, axis=-1) + extent[:, None]

    rotations = jnp.moveaxis(jaxlie.SO3(poses[..., :4]).as_matrix().astype(jnp.float32), (0, 1), (3, 2))
    place = jnp.moveaxis(centers.astype(jnp.float32), (0, 1), (2, 1))
    half = arrays.boxes.half.T.astype(jnp.float32)[:, :, None]
    a, b = arrays.pairs[:, 0], arrays.pairs[:, 1]
    sweep = (arrays.bodies.radius[a] + arrays.bodies.radius[b]).astype(jnp.float32)[:, None]
    bounds = box_bounds(rotations[:, :, a], rotations[:, :, b], place[:, b] - place[:, a], half[:, a], half[:, b])
    return bounds - sweep - _ROUNDING, radius, poses, JointAxes(axis, point)


@jax.jit
def measure_pairs(
    body_a: ConvexBody,
    body_b: ConvexBody,
    pose_a: Float[Array, "R 7"],
    pose_b: Float[Array, "R 7"],
    sign: Float[Array, "R n"],
    joints: JointAxes,
) -> tuple[Float[Array, " R"], Float[Array, " R"], Float[Array, "R n"]]:
    """Distances (R,) and certified lower bounds (R,), metres, and gradients (R, n), m/rad, of R pairs of bodies.

    Args:
        body_a, body_b: R bodies each.
        pose_a, pose_b: (R, 7) their world poses.
        sign: (R, n) of `chain_of_pairs`.
        joints: the joints' axes, row by row.
    """
    # One local maximum is enough: overlapping pairs are only ever pushed apart, and near contact there is one.
    found = separation(body_a, pose_a, body_b, pose_b, thorough=False)
    x = found.direction
    certified = hull_gap(x, body_a, pose_a, body_b, pose_b)
    # A joint moves the second body (+) or the first (−), and its witness point with it.
    witness = jnp.where(sign[..., None] > 0, found.point_b[:, None], found.point_a[:, None])
    gradient = sign * (jnp.cross(joints.axis, witness - joints.point) * x[:, None]).sum(-1)
    return found.distance, certified, gradient
