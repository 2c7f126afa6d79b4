"""IkSolve: collision-free arm configurations that put the gripper at given poses.

Three phases, each for the targets that the one before left unsolved:

1. Damped least squares on the arm alone from many starts, all targets in one batch (`descent`).
2. Clearance of the configurations that converged; the free ones are ranked (`candidates`).
3. Where all of them collide: descent through the arm's null space (`null_space`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from regrasp_planner.collision.clearance import gripper_clearance
from regrasp_planner.collision.model import CollisionModel
from regrasp_planner.ik.candidates import (
    GOOD_CLEARANCE,
    Collision,
    IkSolution,
    TargetSearch,
    batches,
    by_model,
    descend,
    distinct,
    draw_starts,
    ranking_cost,
    screen,
)
from regrasp_planner.ik.null_space import leave_collisions
from regrasp_planner.robot.model import Arm

FIRST_ITERATIONS = 24
FULL_ITERATIONS = 60
"""Iterations of the second attempt, for targets without a solution after the first."""


class IkFailure(StrEnum):
    """Constraint of IkSolve that cannot be met."""

    UNREACHABLE = "unreachable"
    JOINT_LIMITS = "joint limits"
    WORLD_COLLISION = "world collision"
    SELF_COLLISION = "self collision"
    HELD_OBJECT = "held object"


@dataclass(frozen=True)
class IkResult:
    """Solutions for one target, or the reason why there are none.

    Attributes:
        solutions: distinct solutions, best first; empty on failure.
        failure: the constraint that failed, or None on success.
        message: the failure in words, with the joint or the bodies; empty on success.
        nearest: (n,) the best solution; on failure the configuration that came closest, to inspect.
    """

    solutions: tuple[IkSolution, ...]
    failure: IkFailure | None
    message: str
    nearest: Float[np.ndarray, " n"]

    @property
    def success(self) -> bool:
        """Whether there is a solution."""
        return bool(self.solutions)

    @property
    def q(self) -> Float[np.ndarray, " n"]:
        """Configuration of the best solution, (n,) radians.

        Raises:
            ValueError: there is none.
        """
        if not self.solutions:
            raise ValueError(f"inverse kinematics failed: {self.message}")
        return self.solutions[0].q


def solve_ik(
    model: CollisionModel | Sequence[CollisionModel],
    targets: Float[np.ndarray, "K 7"],
    theta: Float[np.ndarray, " K"] | float,
    *,
    reference: Float[np.ndarray, "K n"] | Float[np.ndarray, " n"] | None = None,
    seeds: Float[np.ndarray, "S n"] | None = None,
    max_solutions: int = 4,
    seed: int = 0,
) -> list[IkResult]:
    """Collision-free configurations for K gripper poses, with alternatives.

    Args:
        model: the bodies that may collide, one model for all targets or one per target (all of the same robot).
        targets: (K, 7) poses of the gripper frame in the world.
        theta: finger coordinate at each target, or one for all.
        reference: configuration to stay near, one per target or one for all, radians; default: the robot's home.
            Solutions are ranked by distance from it, distance from the limits, and clearance.
        seeds: (S, n) more configurations to start from, radians.
        max_solutions: largest number of solutions for a target.
        seed: seed of the random starts.

    Returns:
        K results. Solutions are within 0.1 mm and 1 mrad, mostly by orders of magnitude.

    Raises:
        ValueError: a wrong shape, or a pose that is not finite.
    """
    targets = np.atleast_2d(np.asarray(targets, float))
    if targets.ndim != 2 or targets.shape[1] != 7 or not np.isfinite(targets).all():
        raise ValueError(f"targets must be finite poses of shape (K, 7), got shape {targets.shape}")
    count = len(targets)
    models = [model] * count if isinstance(model, CollisionModel) else list(model)
    if len(models) != count:
        raise ValueError(f"{len(models)} collision models for {count} targets; give one, or one per target")
    if not count:
        return []
    robot = models[0].arrays.robot
    arm, home = robot.arm, np.asarray(robot.home, float)
    theta = np.broadcast_to(np.asarray(theta, float), (count,))
    references = np.broadcast_to(home if reference is None else np.asarray(reference, float), (count, arm.dof))
    fixed = home[None] if seeds is None else np.concatenate([home[None], np.asarray(seeds, float).reshape(-1, arm.dof)])
    searches = [
        TargetSearch(its_model, target, float(opening), near, closest=home)
        for its_model, target, opening, near in zip(models, targets, theta, references, strict=True)
    ]
    rng = np.random.default_rng(seed)

    for part in by_model(searches):
        _check_gripper(part)
    for iterations in (FIRST_ITERATIONS, FULL_ITERATIONS):
        for batch in batches([s for s in searches if not s.solutions and s.gripper_collision is None]):
            starts = draw_starts(arm, batch, fixed, rng)
            screen(batch, descend(arm, batch, starts, iterations), max_solutions)
    for batch in batches([s for s in searches if not s.solutions and s.colliding]):
        leave_collisions(batch, max_solutions)
    return [_success(s, max_solutions) if s.solutions else _failure(arm, s) for s in searches]


def _check_gripper(searches: list[TargetSearch]) -> None:
    """Mark the targets of one collision model at which the gripper itself collides."""
    targets, openings = np.stack([s.target for s in searches]), np.array([s.theta for s in searches])
    clearance = gripper_clearance(searches[0].model, targets, openings, cap=0.0)
    for search, value, pair in zip(searches, clearance.value, clearance.pair, strict=True):
        if value < 0:
            search.gripper_collision = Collision(float(value), int(pair), search.closest)


def _success(search: TargetSearch, max_solutions: int) -> IkResult:
    """The best distinct solutions, clearance counted."""
    q = np.stack([solution.q for solution in search.solutions])
    tight = np.array([1.0 - solution.clearance / GOOD_CLEARANCE for solution in search.solutions])
    order = np.argsort(ranking_cost(search, q) + 0.3 * tight, kind="stable")
    order = order[distinct(q[order])][:max_solutions]
    solutions = tuple(search.solutions[i] for i in order)
    return IkResult(solutions, None, "", solutions[0].q)


def _failure(arm: Arm, search: TargetSearch) -> IkResult:
    """The reason, most specific first: gripper collision, collision, joint limits, unreachable."""
    if search.gripper_collision is not None:
        return _collision(search, search.gripper_collision, "at this gripper pose")
    if search.colliding:
        best = max(search.colliding, key=lambda collision: collision.clearance)
        return _collision(search, best, f"in the best of {len(search.colliding)} configurations")
    message = _exceeded_limit(arm, search)
    if message is not None:
        return IkResult((), IkFailure.JOINT_LIMITS, f"{IkFailure.JOINT_LIMITS}: {message}", search.closest)
    unit = search.model.arrays.robot.unit
    position = np.round(search.target[4:] * unit, 3).tolist()
    message = f"gripper position {position} m stays {search.closest_error * unit:.4f} m away"
    return IkResult((), IkFailure.UNREACHABLE, f"{IkFailure.UNREACHABLE}: {message}", search.closest)


def _collision(search: TargetSearch, collision: Collision, where: str) -> IkResult:
    model, pair = search.model, collision.pair
    kind, depth = IkFailure(model.kind(pair)), -collision.clearance * model.arrays.robot.unit
    return IkResult((), kind, f"{kind}: {model.describe(pair)}, {depth:.4f} m too close {where}", collision.q)


def _exceeded_limit(arm: Arm, search: TargetSearch) -> str | None:
    """The limit that a solution with free joints exceeds most; None if there is no such solution."""
    free = replace(arm, lower=jnp.full(arm.dof, -2 * np.pi), upper=jnp.full(arm.dof, 2 * np.pi))
    starts = draw_starts(arm, [search], np.zeros((0, arm.dof)), np.random.default_rng(0))
    ends = descend(free, [search], starts, FULL_ITERATIONS)[0]
    best = int(ends.pose_error().argmin())
    if not ends.solved()[best]:
        return None
    low, high, angles = np.asarray(arm.lower), np.asarray(arm.upper), ends.q[best]
    joint = int(np.maximum(low - angles, angles - high).argmax())
    limits = f"[{low[joint]:.3f}, {high[joint]:.3f}]"
    return f"{arm.joint_names[joint]!r} would have to turn to {angles[joint]:.3f} rad, limits {limits}"
