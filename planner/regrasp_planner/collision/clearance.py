"""Clearance of whole configurations, on the host, with as few distances measured as possible.

One program bounds all pairs from below. Then the nearest pair of each configuration is measured, and then only those
that might be nearer. Batches are padded to bucket sizes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float, Int

from regrasp_planner.batching import bucket, in_batches
from regrasp_planner.collision.least_slack import least_slack
from regrasp_planner.collision.model import CollisionArrays, CollisionModel, body_frames
from regrasp_planner.collision.pairs import gripper_pairs, pair_bounds
from regrasp_planner.geometry.distance import hull_gap, separation
from regrasp_planner.robot.kinematics import forward_kinematics

CONFIGURATION_BUCKETS = (64, 512)
"""Configurations posed and bounded in one call of the compiled program."""
DISTANCE_BATCH = 256
"""Pairs measured in one call of the compiled program."""


@dataclass(frozen=True)
class Clearance:
    """Smallest distance minus margin of N configurations; see `configuration_clearance`.

    Attributes:
        value: (N,) smallest distance minus margin over all pairs, metres, cut at the cap; ≥ 0 is free.
        pair: (N,) the pair that attains it, or −1 where no pair is below the cap.
    """

    value: Float[np.ndarray, " N"]
    pair: Int[np.ndarray, " N"]


def configuration_clearance(
    model: CollisionModel,
    q: Float[np.ndarray, "N n"],
    theta: Float[np.ndarray, " N"] | float,
    cap: float = 0.05,
    exact: bool = False,
) -> Clearance:
    """Smallest distance minus margin of each configuration, over all pairs.

    Args:
        model: the bodies.
        q: (N, n) configurations, radians.
        theta: (N,) finger coordinate of each, or one for all.
        cap: larger clearances are not resolved, metres. 0 answers only whether a configuration is free.
        exact: measure the hulls themselves by `certified_distance`, a rigorous lower bound, instead of the DSF.
    """
    return _clearance(model, q, theta, cap, exact, gripper_only=False)


def gripper_clearance(
    model: CollisionModel, targets: Float[np.ndarray, "N 7"], theta: Float[np.ndarray, " N"] | float, cap: float = 0.05
) -> Clearance:
    """Clearance of the gripper, the last link and the held body from the obstacles, whatever the arm does.

    Args:
        model: the bodies.
        targets: (N, 7) poses of the gripper frame in the world, metres.
        theta, cap: as in `configuration_clearance`.
    """
    return _clearance(model, targets, theta, cap, exact=False, gripper_only=True)


def _clearance(
    model: CollisionModel,
    states: Float[np.ndarray, "N k"],
    theta: Float[np.ndarray, " N"] | float,
    cap: float,
    exact: bool,
    gripper_only: bool,
) -> Clearance:
    states = np.atleast_2d(np.asarray(states, float))
    theta = np.broadcast_to(np.asarray(theta, float), states.shape[:1])
    if not len(states):
        return Clearance(np.zeros(0), np.zeros(0, int))
    poses, bounds = _posed_bounds_in_batches(model.arrays, states, theta, gripper_only)
    margin = np.asarray(model.arrays.margin)

    def slack(rows: Int[np.ndarray, " L"], pairs: Int[np.ndarray, " L"]) -> Float[np.ndarray, " L"]:
        a, b = model.pairs[pairs].T

        def distances(some: Int[np.ndarray, " D"]) -> Float[Array, " D"]:
            # Poses are picked out here, so that the program is the same for any number of configurations.
            both = poses[rows[some], a[some]], poses[rows[some], b[some]]
            return _pair_distances(model.arrays, pairs[some], *both, exact)

        return in_batches(distances, len(pairs), DISTANCE_BATCH) - margin[pairs]

    # With a cap of 0 only the sign counts.
    return Clearance(*least_slack(bounds, slack, cap, floor=0.0 if cap == 0 else -np.inf))


def _posed_bounds_in_batches(
    arrays: CollisionArrays, states: Float[np.ndarray, "N k"], theta: Float[np.ndarray, " N"], gripper_only: bool
) -> tuple[Float[np.ndarray, "N M 7"], Float[np.ndarray, "N P"]]:
    poses, bounds = [], []
    for begin in range(0, len(states), CONFIGURATION_BUCKETS[-1]):
        count = min(len(states) - begin, CONFIGURATION_BUCKETS[-1])
        size = bucket(count, CONFIGURATION_BUCKETS, "configurations")
        some = begin + np.minimum(np.arange(size), count - 1)
        posed = _posed_bounds(arrays, jnp.asarray(states[some]), jnp.asarray(theta[some]), gripper_only)
        poses.append(np.asarray(posed[0])[:count])
        bounds.append(np.asarray(posed[1])[:count])
    return np.concatenate(poses), np.concatenate(bounds)


@partial(jax.jit, static_argnames="gripper_only")
def _posed_bounds(
    arrays: CollisionArrays, states: Float[Array, "N k"], theta: Float[Array, " N"], gripper_only: bool
) -> tuple[Float[Array, "N M 7"], Float[Array, "N P"]]:
    """Poses of the bodies in each state, and lower bounds of distance minus margin.

    States are configurations; if ``gripper_only``, they are gripper poses, and all other pairs have the bound +inf.
    """
    frames = _frames_of_gripper if gripper_only else body_frames
    poses = jax.vmap(partial(frames, arrays))(states, theta)
    bounds = pair_bounds(arrays, poses)
    return poses, jnp.where(gripper_pairs(arrays), bounds, jnp.inf) if gripper_only else bounds


def _frames_of_gripper(
    arrays: CollisionArrays, target: Float[Array, " 7"], theta: Float[Array, ""]
) -> Float[Array, "M 7"]:
    """As `body_frames`, with the gripper frame at the target and the links before the last one at home."""
    home = jnp.asarray(arrays.robot.home, float)
    hand = forward_kinematics(arrays.robot.arm, home)[-1]
    poses = body_frames(arrays, home, theta)
    moved = (jaxlie.SE3(target) @ jaxlie.SE3(hand).inverse() @ jaxlie.SE3(poses)).wxyz_xyz
    return jnp.where((arrays.mover == arrays.robot.arm.dof)[:, None], moved, poses)


@jax.jit
def _pair_distances(
    arrays: CollisionArrays,
    pairs: Int[Array, " L"],
    poses_a: Float[Array, "L 7"],
    poses_b: Float[Array, "L 7"],
    exact: bool,
) -> Float[Array, " L"]:
    bodies_a, bodies_b = arrays.bodies[arrays.pairs[pairs, 0]], arrays.bodies[arrays.pairs[pairs, 1]]
    apart = separation(bodies_a, poses_a, bodies_b, poses_b)
    return jnp.where(exact, hull_gap(apart.direction, bodies_a, poses_a, bodies_b, poses_b), apart.distance)
