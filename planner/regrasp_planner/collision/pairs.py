"""Pairs of bodies inside compiled programs: lower bounds of their distances, and distances with derivatives.

A distance costs microseconds, so pairs are culled first: each body's hull lies in a box along its own axes, and the
distance of two such boxes is a rigorous lower bound.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from regrasp_planner.collision.model import CollisionArrays, body_frames
from regrasp_planner.geometry.boxes import box_bounds
from regrasp_planner.geometry.distance import separation
from regrasp_planner.robot.kinematics import forward_kinematics, joint_axes


def gripper_pairs(arrays: CollisionArrays) -> Bool[Array, " P"]:
    """Which pairs (P,) depend on the gripper's pose alone: bodies fixed to it and bodies that stand still."""
    movers = arrays.mover[arrays.pairs]
    return (movers.max(-1) == arrays.robot.arm.dof) & (movers.min(-1) == 0)


def pair_bounds(arrays: CollisionArrays, poses: Float[Array, "*N M 7"]) -> Float[Array, "*N P"]:
    """Lower bounds (*N, P) of distance minus margin, metres, from the bodies' boxes; +inf for padding.

    Args:
        arrays: the model.
        poses: (*N, M, 7) from `body_frames`; give all configurations at once rather than under vmap.
    """
    # Configurations last: the picks by body are then copies of whole rows, and the rest is elementwise.
    rows = jnp.moveaxis(poses.reshape(-1, *poses.shape[-2:]), 0, -1)
    w, x, y, z = (rows[:, i] for i in range(4))
    turn = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    local = arrays.boxes.center[:, :, None]
    center = [rows[:, 4 + i] + sum(turn[i][j] * local[:, j] for j in range(3)) for i in range(3)]
    half = arrays.boxes.half.T[:, :, None]
    a, b = arrays.pairs[:, 0], arrays.pairs[:, 1]
    distance = box_bounds(
        [[entry[a] for entry in row] for row in turn],
        [[entry[b] for entry in row] for row in turn],
        [along[b] - along[a] for along in center],
        half[:, a],
        half[:, b],
    )
    needed = arrays.bodies.radius[a] + arrays.bodies.radius[b] + arrays.margin
    bounds = jnp.where(arrays.valid[:, None], distance - needed[:, None], jnp.inf)
    return jnp.moveaxis(bounds, -1, 0).reshape(*poses.shape[:-2], -1)


def pair_clearances(
    arrays: CollisionArrays, q: Float[Array, " n"], theta: Float[Array, ""], pairs: Int[Array, " K"]
) -> Float[Array, " K"]:
    """Distance minus margin of K pairs, differentiable once by q, forwards and backwards.

    Args:
        arrays: the model.
        q: (n,) radians.
        theta: finger coordinate; there are no derivatives by it.
        pairs: (K,) pair numbers. Padding pairs have clearance +1 m and derivative 0.

    Returns:
        (K,) metres.
    """
    fixed = jax.lax.stop_gradient(q)
    value, slope = _clearances_and_slopes(arrays, fixed, jax.lax.stop_gradient(theta), pairs)
    return value + jax.lax.stop_gradient(slope) @ (q - fixed)


def _clearances_and_slopes(
    arrays: CollisionArrays, q: Float[Array, " n"], theta: Float[Array, ""], pairs: Int[Array, " K"]
) -> tuple[Float[Array, " K"], Float[Array, "K n"]]:
    """Distance minus margin (K,), metres, and its derivatives (K, n) by the joints, metres per radian.

    Witness points are material points of their bodies (envelope theorem). With contact normal x from A to B, the
    derivative by joint i is x·(v_B − v_A) with v = a_i × (p − o_i) for the bodies that the joint moves.
    """
    arm, poses = arrays.robot.arm, body_frames(arrays, q, theta)
    a, b = arrays.pairs[pairs, 0], arrays.pairs[pairs, 1]
    apart = separation(arrays.bodies[a], poses[a], arrays.bodies[b], poses[b])
    axis, origin = joint_axes(arm, forward_kinematics(arm, q))
    normal, order = apart.direction[:, None, :], jnp.arange(1, arm.dof + 1)

    def speed(point: Float[Array, "K 3"], body: Int[Array, " K"]) -> Float[Array, "K n"]:
        moving = arrays.mover[body][:, None] >= order
        return jnp.where(moving, (normal * jnp.cross(axis, point[:, None, :] - origin)).sum(-1), 0.0)

    slope = speed(apart.point_b, b) - speed(apart.point_a, a)
    valid = arrays.valid[pairs]
    return jnp.where(valid, apart.distance - arrays.margin[pairs], 1.0), jnp.where(valid[:, None], slope, 0.0)
