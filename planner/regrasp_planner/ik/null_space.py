"""The arm's null space: from colliding configurations to free ones, with the gripper kept at its target.

The paper's augmented Lagrangian with trust region over the joints. The pose is an equality; clearance and joint limits
are inequalities.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from regrasp_planner.collision.model import CollisionArrays, body_frames
from regrasp_planner.collision.pairs import gripper_pairs, pair_bounds, pair_clearances
from regrasp_planner.ik.candidates import STARTS, TargetSearch, by_model, descend, screen
from regrasp_planner.optim.augmented_lagrangian import Options, Stall, augmented_lagrangian
from regrasp_planner.optim.manifold import Euclidean
from regrasp_planner.robot.kinematics import forward_kinematics, pose_error

LANES, ACTIVE_PAIRS = 8, 24
"""Starts in one batch, and pairs of bodies that each keeps apart."""
POLISH_ITERATIONS = 24
"""Iterations of the descent that brings the pose to full precision afterwards."""


@jax.jit
def _nearest_pairs(arrays: CollisionArrays, q: Float[Array, "L n"], theta: Float[Array, " L"]) -> Int[Array, "L C"]:
    """The nearest pairs whose distance the arm's motion can change."""
    poses = jax.vmap(lambda angles, opening: body_frames(arrays, angles, opening))(q, theta)
    bounds = jnp.where(gripper_pairs(arrays), jnp.inf, pair_bounds(arrays, poses))
    return jax.lax.top_k(-bounds, ACTIVE_PAIRS)[1]


@jax.jit
def _clear_pairs(arrays: CollisionArrays, q: Float[Array, "L n"], *params: Array) -> Float[Array, "L n"]:
    """Augmented Lagrangian over the joints; ``params``: (L, 7) targets, (L,) openings, (L, C) pairs to keep apart."""
    arm = arrays.robot.arm
    span = arm.upper - arm.lower

    def problem(q: Array, params: tuple[Array, ...]) -> tuple[Array, Array, Array]:
        target, opening, pairs, start = params
        error = pose_error(forward_kinematics(arm, q)[-1], target)
        # Units in which all constraints change by about one over the region of interest.
        pose = error / jnp.array([0.1] * 3 + [0.5] * 3)
        free = pair_clearances(arrays, q, opening, pairs) / 0.05
        limits = jnp.concatenate([q - arm.lower, arm.upper - q])
        return 0.05 * jnp.sum(((q - start) / span) ** 2), pose, jnp.concatenate([free, limits])

    def solve(start: Array, *params: Array) -> Array:
        return augmented_lagrangian(
            problem,
            start,
            Euclidean(arm.dof),
            # The first feasible point is enough.
            Options(60, max_inner=8, constraint_tolerance=1e-3, initial_radius=0.5, stall=Stall(np.inf, 1)),
            params=(*params, start),
            counts=(6, ACTIVE_PAIRS + 2 * arm.dof),
        ).point

    return jax.vmap(solve)(q, *params)


def leave_collisions(batch: list[TargetSearch], max_solutions: int) -> None:
    """Look for solutions from the least violating configurations, one batch for each collision model."""
    for part in by_model(batch):
        model = part[0].model
        lanes = [part[i % len(part)] for i in range(LANES)]
        starts: list[Float[np.ndarray, " n"]] = []
        for lane, search in enumerate(lanes):
            ranked = sorted(search.colliding, key=lambda collision: -collision.clearance)
            starts.append(ranked[min(lane // len(part), len(ranked) - 1)].q)
        q, theta = jnp.asarray(np.stack(starts)), jnp.asarray([search.theta for search in lanes])
        targets = jnp.asarray(np.stack([search.target for search in lanes]))
        moved = np.asarray(_clear_pairs(model.arrays, q, targets, theta, _nearest_pairs(model.arrays, q, theta)))
        repeated = np.repeat(moved[:, None], STARTS, axis=1)
        screen(part, descend(model.arrays.robot.arm, part, repeated, POLISH_ITERATIONS), max_solutions)
