"""IkSolve: arm configurations that put the gripper where a grasp wants it, clear of everything.

Three phases, each for the targets the one before left unsolved. (1) Damped least squares on the arm alone from many
starts, all targets in one batch. (2) Clearance of what converged; the free ones are ranked. (3) Where everything
collides: the paper's augmented Lagrangian with trust region over the joints, the pose as equality, clearance and
joint limits as inequalities, from the configurations that violate least. It moves through the arm's null space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum, StrEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from regrasp_planner.batching import bucket_size
from regrasp_planner.collision.clearance import configuration_clearance, gripper_clearance
from regrasp_planner.collision.model import CollisionArrays, CollisionModel, body_frames
from regrasp_planner.collision.pairs import gripper_pairs, pair_bounds, pair_clearances
from regrasp_planner.ik.descent import ROTATION_LENGTH, reach
from regrasp_planner.optim.augmented_lagrangian import ConstrainedResult, Options, Stall, augmented_lagrangian
from regrasp_planner.optim.manifold import Euclidean
from regrasp_planner.robot.kinematics import forward_kinematics, pose_error
from regrasp_planner.robot.model import Arm

POSITION_TOLERANCE = 1e-4
ROTATION_TOLERANCE = 1e-3
SLOTS, STARTS = 8, 32
"""Starts run in lanes of 8 slots × 32, whatever the number of targets, which share the slots evenly."""
QUICK_TARGETS, QUICK_STARTS, QUICK_ENOUGH, QUICK_TOLERANCE = (8, 32), 12, 4, 5e-3
"""Of `within_reach`: targets in a batch, starts for each, solutions looked at, and the miss (metres) that passes."""
ENOUGH = 10
FIRST_ITERATIONS = 24
FULL_ITERATIONS = 60
LANES, ACTIVE_PAIRS = 8, 24
SAME_CONFIGURATION = 0.1
"""Configurations closer than this in every joint (radians) count as one."""
GOOD_CLEARANCE = 0.03


class IkFailure(StrEnum):
    """Which constraint of IkSolve cannot be met."""

    UNREACHABLE = "unreachable"
    JOINT_LIMITS = "joint limits"
    WORLD_COLLISION = "world collision"
    SELF_COLLISION = "self collision"
    HELD_OBJECT = "held object"


@dataclass(frozen=True)
class IkSolution:
    """A configuration free of collisions with the gripper at its target.

    Attributes:
        q: (n,) radians.
        position_error: metres.
        rotation_error: radians.
        clearance: smallest distance minus margin, metres, cut at `GOOD_CLEARANCE`.
    """

    q: Float[np.ndarray, " n"]
    position_error: float
    rotation_error: float
    clearance: float


@dataclass(frozen=True)
class IkResult:
    """Outcome for one target.

    Attributes:
        solutions: distinct solutions, best first; empty on failure.
        failure: the constraint that failed, or None.
        message: the same in words, naming joint or bodies.
        nearest: (n,) the configuration that came closest, for looking at failures; the best solution on success.
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
        """The best solution's configuration (n,), radians; raises ``ValueError`` on failure."""
        if not self.solutions:
            raise ValueError(f"inverse kinematics failed: {self.message}")
        return self.solutions[0].q


@dataclass
class _Search:
    """What is known about one target."""

    target: Float[np.ndarray, " 7"]
    theta: float
    model: CollisionModel
    reference: Float[np.ndarray, " n"]
    found: list[IkSolution]
    colliding: list[tuple[float, int, Float[np.ndarray, " n"]]]
    closest: tuple[float, Float[np.ndarray, " n"]]
    hopeless: tuple[float, int] | None = None
    """Clearance and pair where the gripper itself, wherever the arm is, hits something at the target."""


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
    """Configurations for K gripper poses, each with alternatives.

    Args:
        model: what may be hit, one for all targets or one per target (all of the same robot).
        targets: (K, 7) poses of the gripper frame in the world.
        theta: finger coordinate at each target, or one for all.
        reference: configurations to stay near (of each target or of all), radians; default: the robot's home.
            Solutions are ranked by distance from it, from the limits, and by clearance.
        seeds: (S, n) further configurations to start from.
        max_solutions: most solutions to return for a target.
        seed: of the random starts.

    Returns:
        K results. The errors of a solution are below 0.1 mm and 1 mrad, mostly by orders of magnitude.

    Raises:
        ValueError: wrong shapes, or a pose that is not finite.
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
    arm = robot.arm
    theta = np.broadcast_to(np.asarray(theta, float), (count,))
    home = np.asarray(robot.home, float)
    references = np.broadcast_to(home if reference is None else np.asarray(reference, float), (count, arm.dof))
    seeds = np.zeros((0, arm.dof)) if seeds is None else np.asarray(seeds, float).reshape(-1, arm.dof)
    searches = [
        _Search(target, float(opening), m, ref, [], [], (np.inf, home))
        for target, opening, m, ref in zip(targets, theta, models, references, strict=True)
    ]
    rng = np.random.default_rng(seed)

    for m in {id(m): m for m in models}.values():
        part = [search for search in searches if search.model is m]
        held_fast = gripper_clearance(m, np.stack([s.target for s in part]), np.array([s.theta for s in part]), cap=0.0)
        for search, value, pair in zip(part, held_fast.value, held_fast.pair, strict=True):
            search.hopeless = (float(value), int(pair)) if value < 0 else None

    for iterations in (FIRST_ITERATIONS, FULL_ITERATIONS):
        for group in _groups([s for s in searches if not s.found and s.hopeless is None]):
            starts = _starts(arm, group, np.concatenate([home[None], seeds]), rng)
            _screen(group, _reached(arm, group, starts, iterations), max_solutions)
    for group in _groups([s for s in searches if not s.found and s.colliding]):
        _escape(arm, group, max_solutions)
    return [_result(arm, search, max_solutions) for search in searches]


class Reachability(IntEnum):
    """What a quick look says of a gripper pose; see `within_reach`."""

    NONE = 0
    """No configuration within the joint limits was found."""
    BLOCKED = 1
    """There are configurations, but in those looked at the arm hits something."""
    FREE = 2
    """There is a configuration in which the bodies of the model are clear."""


def within_reach(
    model: CollisionModel, targets: Float[np.ndarray, "K 7"], seed: int = 0, collisions: bool = True
) -> Int[np.ndarray, " K"]:
    """A quick look from a few starts at which gripper poses the arm can take.

    Args:
        model: what may be hit; commonly without the gripper, whose collisions are for the evaluation of grasps.
        targets: (K, 7) poses of the gripper frame in the world.
        seed: of the random starts.
        collisions: whether they count; if not, what can be reached at all is free.

    Returns:
        (K,) `Reachability` of each.
    """
    robot, count = model.arrays.robot, len(targets)
    arm, home = robot.arm, np.asarray(robot.home, float)
    low, high = np.asarray(arm.lower, float), np.asarray(arm.upper, float)
    starts = np.random.default_rng(seed).uniform(low, high, (QUICK_TARGETS[-1], QUICK_STARTS, arm.dof))
    starts[:, 0] = home
    grades = np.full(count, int(Reachability.NONE))
    for begin in range(0, count, QUICK_TARGETS[-1]):
        chosen = np.arange(begin, min(begin + QUICK_TARGETS[-1], count))
        size = bucket_size(len(chosen), QUICK_TARGETS)
        some, tried = jnp.asarray(targets[np.resize(chosen, size)]), jnp.asarray(starts[:size])
        ends = reach(arm, some, tried, jnp.asarray(QUICK_ENOUGH), jnp.asarray(FIRST_ITERATIONS))
        lanes = _Lanes(*map(np.asarray, ends))
        solved = (lanes.miss() < QUICK_TOLERANCE).reshape(size, QUICK_STARTS)[: len(chosen)]
        q = lanes.q.reshape(size, QUICK_STARTS, -1)[: len(chosen)]
        grades[chosen[solved.any(axis=1)]] = Reachability.BLOCKED if collisions else Reachability.FREE
        if not collisions:
            continue
        # Those nearest to home first.
        order = np.where(solved, np.linalg.norm((q - home) / (high - low), axis=2), np.inf).argsort(axis=1)
        for rank in range(QUICK_ENOUGH):
            rows = np.flatnonzero((grades[chosen] == Reachability.BLOCKED) & (solved.sum(axis=1) > rank))
            if len(rows):
                clearance = configuration_clearance(model, q[rows, order[rows, rank]], 0.0, cap=0.0)
                grades[chosen[rows[clearance.value >= 0]]] = Reachability.FREE
    return grades


def _groups(searches: list[_Search]) -> list[list[_Search]]:
    return [searches[i : i + SLOTS] for i in range(0, len(searches), SLOTS)]


def _starts(
    arm: Arm, group: list[_Search], fixed: Float[np.ndarray, "S n"], rng: np.random.Generator
) -> Float[np.ndarray, "slots starts n"]:
    """Random starts within the limits; the first ones of each slot are the reference and the fixed ones."""
    low, high = np.asarray(arm.lower, float), np.asarray(arm.upper, float)
    starts = rng.uniform(low, high, (SLOTS, STARTS, arm.dof))
    for slot in range(min(SLOTS, len(group))):
        known = np.concatenate([group[slot].reference[None], fixed])[: STARTS // 2]
        starts[slot, : len(known)] = known
    return starts


class _Lanes(NamedTuple):
    """`Reached` on the host."""

    q: Float[np.ndarray, "L n"]
    position_error: Float[np.ndarray, " L"]
    rotation_error: Float[np.ndarray, " L"]

    def miss(self) -> Float[np.ndarray, " L"]:
        """Pose error in metres, a radian counting as `ROTATION_LENGTH`."""
        return self.position_error + ROTATION_LENGTH * self.rotation_error

    def solved(self) -> Bool[np.ndarray, " L"]:
        """Which lanes are within the tolerances."""
        return (self.position_error < POSITION_TOLERANCE) & (self.rotation_error < ROTATION_TOLERANCE)


def _reached(
    arm: Arm, group: list[_Search], starts: Float[np.ndarray, "slots starts n"], iterations: int
) -> list[_Lanes]:
    """`reach` for each search; searches share the slots in turn."""
    owner = np.arange(SLOTS) % len(group)
    targets = np.stack([group[i].target for i in owner])
    lanes = reach(arm, jnp.asarray(targets), jnp.asarray(starts), jnp.asarray(ENOUGH), jnp.asarray(iterations))
    host = [np.asarray(leaf) for leaf in lanes]
    which = np.repeat(owner, STARTS)
    return [_Lanes(*(leaf[which == i] for leaf in host)) for i in range(len(group))]


def _limit_nearness(arm: Arm, q: Float[np.ndarray, "N n"]) -> Float[np.ndarray, " N"]:
    """0 in the middle of the ranges, 1 for each joint at a limit."""
    low, high = np.asarray(arm.lower), np.asarray(arm.upper)
    return (((2 * q - low - high) / (high - low)) ** 8).sum(1)


def _cost(arm: Arm, search: _Search, q: Float[np.ndarray, "N n"]) -> Float[np.ndarray, " N"]:
    """Ranking before clearance is known: distance from the reference in units of the joints' ranges, and limits."""
    span = np.asarray(arm.upper) - np.asarray(arm.lower)
    return np.linalg.norm((q - search.reference) / span, axis=1) + 0.2 * _limit_nearness(arm, q)


def _distinct(q: Float[np.ndarray, "N n"]) -> list[int]:
    """Indices of configurations that differ from all kept before."""
    kept: list[int] = []
    for i in range(len(q)):
        if not kept or np.abs(q[kept] - q[i]).max(1).min() > SAME_CONFIGURATION:
            kept.append(i)
    return kept


def _candidates(arm: Arm, search: _Search, lanes: _Lanes) -> list[IkSolution]:
    """Distinct configurations at the target, best ranked first, their clearance not yet known."""
    order = np.flatnonzero(lanes.solved())
    order = order[np.argsort(_cost(arm, search, lanes.q[order]), kind="stable")]
    order = order[_distinct(lanes.q[order])]
    return [
        IkSolution(lanes.q[i], float(lanes.position_error[i]), float(lanes.rotation_error[i]), np.nan) for i in order
    ]


def _screen(group: list[_Search], reached: list[_Lanes], max_solutions: int) -> None:
    """Sort what converged into free and colliding, best ranked first, until there are enough free ones."""
    arm = group[0].model.arrays.robot.arm
    for search, lanes in zip(group, reached, strict=True):
        miss = lanes.miss()
        best = int(miss.argmin())
        if miss[best] < search.closest[0]:
            search.closest = (float(miss[best]), lanes.q[best])
    waiting = [(search, _candidates(arm, search, lanes)) for search, lanes in zip(group, reached, strict=True)]
    batch = max(max_solutions, -(-64 // len(group)))
    for begin in range(0, SLOTS * STARTS, batch):
        now = [
            (search, candidate)
            for search, candidates in waiting
            if len(search.found) < max_solutions
            for candidate in candidates[begin : begin + batch]
        ]
        for model in {id(search.model): search.model for search, _ in now}.values():
            part = [(search, candidate) for search, candidate in now if search.model is model]
            q = np.stack([candidate.q for _, candidate in part])
            openings = np.array([search.theta for search, _ in part])
            clearance = configuration_clearance(model, q, openings, cap=GOOD_CLEARANCE)
            for (search, candidate), value, pair in zip(part, clearance.value, clearance.pair, strict=True):
                if value >= 0:
                    search.found.append(replace(candidate, clearance=float(value)))
                else:
                    search.colliding.append((float(value), int(pair), candidate.q))


@jax.jit
def _descend(
    arrays: CollisionArrays,
    targets: Float[Array, "L 7"],
    theta: Float[Array, " L"],
    starts: Float[Array, "L n"],
    pairs: Int[Array, "L C"],
) -> ConstrainedResult:
    """Augmented Lagrangian over the joints, L lanes, each with the C pairs that were nearest at its start."""
    arm = arrays.robot.arm
    span = arm.upper - arm.lower

    def problem(q: Array, params: tuple[Array, ...]) -> tuple[Array, Array, Array]:
        target, opening, chosen, start = params
        error = pose_error(forward_kinematics(arm, q)[-1], target)
        # Units in which all constraints change by about one over the region of interest.
        pose = error / jnp.array([0.1] * 3 + [0.5] * 3)
        free = pair_clearances(arrays, q, opening, chosen) / 0.05
        limits = jnp.concatenate([q - arm.lower, arm.upper - q])
        return 0.05 * jnp.sum(((q - start) / span) ** 2), pose, jnp.concatenate([free, limits])

    def solve(start: Array, *params: Array) -> ConstrainedResult:
        return augmented_lagrangian(
            problem,
            start,
            Euclidean(arm.dof),
            # The first feasible point will do.
            Options(60, max_inner=8, constraint_tolerance=1e-3, initial_radius=0.5, stall=Stall(np.inf, 1)),
            params=(*params, start),
            counts=(6, pairs.shape[1] + 2 * arm.dof),
        )

    return jax.vmap(solve)(starts, targets, theta, pairs)


@jax.jit
def _near(arrays: CollisionArrays, q: Float[Array, "L n"], theta: Float[Array, " L"]) -> Int[Array, "L C"]:
    """The nearest pairs that the arm's motion can change."""
    poses = jax.vmap(lambda angles, opening: body_frames(arrays, angles, opening))(q, theta)
    bounds = jnp.where(gripper_pairs(arrays), jnp.inf, pair_bounds(arrays, poses))
    return jax.lax.top_k(-bounds, ACTIVE_PAIRS)[1]


def _escape(arm: Arm, group: list[_Search], max_solutions: int) -> None:
    """Phase 3, model by model: descend from the least violating configurations, then finish the pose exactly."""
    for model in {id(search.model): search.model for search in group}.values():
        part = [search for search in group if search.model is model]
        owner = [part[i % len(part)] for i in range(LANES)]
        starts: list[Float[np.ndarray, " n"]] = []
        for lane, search in enumerate(owner):
            ranked = sorted(search.colliding, key=lambda entry: -entry[0])
            starts.append(ranked[min(lane // len(part), len(ranked) - 1)][2])
        q, theta = jnp.asarray(np.stack(starts)), jnp.asarray([search.theta for search in owner])
        targets = jnp.asarray(np.stack([search.target for search in owner]))
        result = _descend(model.arrays, targets, theta, q, _near(model.arrays, q, theta))
        moved = np.asarray(result.point)
        lanes = np.stack([np.tile(moved[i], (STARTS, 1)) for i in range(LANES)])
        _screen(part, _reached(arm, part, lanes, FIRST_ITERATIONS), max_solutions)


def _result(arm: Arm, search: _Search, max_solutions: int) -> IkResult:
    if search.found:
        q = np.stack([solution.q for solution in search.found])
        tight = np.array([1.0 - solution.clearance / GOOD_CLEARANCE for solution in search.found])
        order = np.argsort(_cost(arm, search, q) + 0.3 * tight, kind="stable")
        order = order[_distinct(q[order])][:max_solutions]
        solutions = tuple(search.found[i] for i in order)
        return IkResult(solutions, None, "", solutions[0].q)
    unit = search.model.arrays.robot.unit
    if search.hopeless is not None:
        value, pair = search.hopeless
        kind = IkFailure(search.model.kind(pair))
        message = f"{kind}: {search.model.describe(pair)}, {-value * unit:.4f} m too close at this gripper pose"
        return IkResult((), kind, message, search.closest[1])
    if search.colliding:
        value, pair, q = max(search.colliding, key=lambda entry: entry[0])
        kind = IkFailure(search.model.kind(pair))
        names = search.model.describe(pair)
        message = (
            f"{kind}: {names}, {-value * unit:.4f} m too close in the best of {len(search.colliding)} configurations"
        )
        return IkResult((), kind, message, q)
    error, q = search.closest
    free = replace(arm, lower=jnp.full(arm.dof, -2 * np.pi), upper=jnp.full(arm.dof, 2 * np.pi))
    starts = _starts(arm, [search], np.zeros((0, arm.dof)), np.random.default_rng(0))
    lanes = _reached(free, [search], starts, FULL_ITERATIONS)[0]
    best = int(lanes.miss().argmin())
    if lanes.solved()[best]:
        low, high = np.asarray(arm.lower), np.asarray(arm.upper)
        angles = lanes.q[best]
        beyond = np.maximum(low - angles, angles - high)
        joint = int(beyond.argmax())
        message = f"joint limits: {arm.joint_names[joint]!r} would have to turn to {angles[joint]:.3f} rad"
        message += f", limits [{low[joint]:.3f}, {high[joint]:.3f}]"
        return IkResult((), IkFailure.JOINT_LIMITS, message, q)
    position = np.round(search.target[4:] * unit, 3).tolist()
    message = f"unreachable: gripper position {position} m stays {error * unit:.4f} m away"
    return IkResult((), IkFailure.UNREACHABLE, message, q)
