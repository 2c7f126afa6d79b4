"""Clearance of whole configurations, on the host, with as few distances as it takes to be sure.

Bounds of all pairs come first, in one program; then the nearest pair of each configuration is measured, and then only
those that might be nearer still. Batches are padded to bucket sizes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float, Int

from regrasp_planner.batching import bucket
from regrasp_planner.collision.least_slack import least_slack
from regrasp_planner.collision.model import CollisionArrays, CollisionModel, body_frames, gripper_pairs, pair_bounds
from regrasp_planner.geometry.distance import hull_gap, separation
from regrasp_planner.robot.kinematics import forward_kinematics

CONFIGURATION_BUCKETS = (64, 512)
DISTANCE_BATCH = 256


@dataclass(frozen=True)
class Clearance:
    """Result of `configuration_clearance` for N configurations.

    Attributes:
        value: (N,) smallest distance minus margin over all pairs, metres, cut at the cap; ≥ 0 is free.
        distance: (N,) the distance itself of the pair that attains it, metres (the cap if there is none).
        pair: (N,) that pair, or −1 where nothing is closer than the cap.
    """

    value: Float[np.ndarray, " N"]
    distance: Float[np.ndarray, " N"]
    pair: Int[np.ndarray, " N"]


@jax.jit
def _posed_bounds(
    arrays: CollisionArrays, q: Float[Array, "N n"], theta: Float[Array, " N"]
) -> tuple[Float[Array, "N M 7"], Float[Array, "N P"]]:
    poses = jax.vmap(lambda angles, opening: body_frames(arrays, angles, opening))(q, theta)
    return poses, pair_bounds(arrays, poses)


@jax.jit
def _posed_gripper_bounds(
    arrays: CollisionArrays, targets: Float[Array, "N 7"], theta: Float[Array, " N"]
) -> tuple[Float[Array, "N M 7"], Float[Array, "N P"]]:
    """As `_posed_bounds`, with the gripper and what moves with it at the targets, and no pairs but theirs."""
    home = jnp.asarray(arrays.robot.home, float)
    hand = forward_kinematics(arrays.robot.arm, home)[-1]
    rigid = arrays.mover == arrays.robot.arm.dof

    def posed(target: Float[Array, " 7"], opening: Float[Array, ""]) -> Float[Array, "M 7"]:
        poses = body_frames(arrays, home, opening)
        moved = (jaxlie.SE3(target) @ jaxlie.SE3(hand).inverse() @ jaxlie.SE3(poses)).wxyz_xyz
        return jnp.where(rigid[:, None], moved, poses)

    poses = jax.vmap(posed)(targets, theta)
    return poses, jnp.where(gripper_pairs(arrays), pair_bounds(arrays, poses), jnp.inf)


@jax.jit
def _selected_distances(
    arrays: CollisionArrays,
    poses_a: Float[Array, "L 7"],
    poses_b: Float[Array, "L 7"],
    pairs: Int[Array, " L"],
    exact: bool,
) -> Float[Array, " L"]:
    bodies_a, bodies_b = arrays.bodies[arrays.pairs[pairs, 0]], arrays.bodies[arrays.pairs[pairs, 1]]
    apart = separation(bodies_a, poses_a, bodies_b, poses_b)
    return jnp.where(exact, hull_gap(apart.direction, bodies_a, poses_a, bodies_b, poses_b), apart.distance)


def configuration_clearance(
    model: CollisionModel,
    q: Float[np.ndarray, "N n"],
    theta: Float[np.ndarray, " N"] | float,
    cap: float = 0.05,
    exact: bool = False,
) -> Clearance:
    """Smallest distance minus margin of each configuration, over all pairs.

    Pairs are culled by `pair_bounds`: first the nearest pair of each configuration is measured, then every pair that
    might be nearer still. Nothing that could be the minimum is left out.

    Args:
        model: the bodies.
        q: (N, n) configurations, radians; N is padded to a bucket.
        theta: (N,) finger coordinate of each, or one for all.
        cap: metres; clearances above are not resolved. 0 answers only whether a configuration is free.
        exact: measure with `certified_distance`, a rigorous lower bound for the exact hulls, and not with the DSF.
    """
    return _clearance(_posed_bounds, model, q, theta, cap, exact)


def gripper_clearance(
    model: CollisionModel,
    targets: Float[np.ndarray, "N 7"],
    theta: Float[np.ndarray, " N"] | float,
    cap: float = 0.05,
    exact: bool = False,
) -> Clearance:
    """Clearance of the gripper, the last link and the held body from the obstacles, whatever the arm does.

    Args:
        model: the bodies.
        targets: (N, 7) poses of the gripper frame in the world.
        theta, cap, exact: as in `configuration_clearance`.
    """
    return _clearance(_posed_gripper_bounds, model, targets, theta, cap, exact)


_Posing = Callable[[CollisionArrays, Array, Array], tuple[Array, Array]]


def _clearance(
    posing: _Posing,
    model: CollisionModel,
    states: Float[np.ndarray, "N k"],
    theta: Float[np.ndarray, " N"] | float,
    cap: float,
    exact: bool,
) -> Clearance:
    states = np.atleast_2d(np.asarray(states, float))
    theta = np.broadcast_to(np.asarray(theta, float), states.shape[:1])
    size = CONFIGURATION_BUCKETS[-1]
    parts = [
        _clearance_chunk(posing, model, states[i : i + size], theta[i : i + size], cap, exact)
        for i in range(0, len(states), size)
    ]
    if not parts:
        return Clearance(np.zeros(0), np.zeros(0), np.zeros(0, int))
    return Clearance(
        np.concatenate([part.value for part in parts]),
        np.concatenate([part.distance for part in parts]),
        np.concatenate([part.pair for part in parts]),
    )


def _clearance_chunk(
    posing: _Posing,
    model: CollisionModel,
    states: Float[np.ndarray, "N k"],
    theta: Float[np.ndarray, " N"],
    cap: float,
    exact: bool,
) -> Clearance:
    count = len(states)
    size = bucket(count, CONFIGURATION_BUCKETS, "configurations")
    fill = np.minimum(np.arange(size), count - 1)
    poses, bounds = posing(model.arrays, jnp.asarray(states[fill]), jnp.asarray(theta[fill]))
    bounds, poses = np.asarray(bounds)[:count], np.asarray(poses)
    margin = np.asarray(model.arrays.margin)

    def slack(rows: Int[np.ndarray, " L"], pairs: Int[np.ndarray, " L"]) -> Float[np.ndarray, " L"]:
        return _measure(model, poses, rows, pairs, exact) - margin[pairs]

    # With a cap of 0 only the sign counts.
    value, pair = least_slack(bounds, slack, cap, floor=0.0 if cap == 0 else -np.inf)
    distance = np.where(pair >= 0, value + margin[pair], cap)
    return Clearance(value, distance, pair)


def _measure(
    model: CollisionModel,
    poses: Float[np.ndarray, "N M 7"],
    rows: Int[np.ndarray, " L"],
    pairs: Int[np.ndarray, " L"],
    exact: bool,
) -> Float[np.ndarray, " L"]:
    """Distances of pair ``pairs[i]`` in configuration ``rows[i]``, in padded batches."""
    result = np.zeros(len(pairs))
    a, b = model.pairs[pairs].T
    for i in range(0, len(pairs), DISTANCE_BATCH):
        count = len(pairs[i : i + DISTANCE_BATCH])
        fill = i + np.minimum(np.arange(DISTANCE_BATCH), count - 1)
        # Poses are picked out here, so that the program is the same for any number of configurations.
        both = poses[rows[fill], a[fill]], poses[rows[fill], b[fill]]
        distances = _selected_distances(model.arrays, *both, pairs[fill], exact)
        result[i : i + count] = np.asarray(distances)[:count]
    return result
