"""PathPlan: collision-free, smooth, timed motions of the arm, in joint space and along straight lines of the gripper.

`plan_path` makes these attempts in turn and returns the first that passes the exact check of the *timed* motion:

1. the straight line in joint space, which is the optimum when nothing is in the way;
2. trajectory optimisation (`optimizer`) from several initial guesses, the least obstructed first (`guesses`);
3. RRT-Connect (`rrt`), shortened, as the initial guess of the same optimisation; if the optimised curve does not pass,
   the polyline itself, which rests at each corner. A short search comes after half of the guesses.

Each pair of bodies keeps its margin of the collision model. A pair that is closer than its margin at an end of the path
has its margin relieved there; see `PathClearance`. Every returned trajectory was certified against the exact hulls over
its whole duration, between samples too (`certificate`).
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from jaxtyping import Float

from regrasp_planner.ik.line import Line, follow_line
from regrasp_planner.path.attempts import Attempt, path_attempts, timed_attempt
from regrasp_planner.path.clearance import Collision, PathClearance, path_clearance
from regrasp_planner.path.optimizer import bspline
from regrasp_planner.path.options import PathOptions
from regrasp_planner.path.query import LineQuery, PathQuery
from regrasp_planner.path.space import ConfigurationSpace
from regrasp_planner.path.trajectory import Trajectory, interpolating_path

_SLACK = 1e-3
"""Clearance beyond the margin that the optimiser asks for: its tolerance, and what happens between its samples."""


class PathStatus(Enum):
    """Why a path was or was not found."""

    SUCCESS = "success"
    OUT_OF_LIMITS = "start or goal outside the joint limits"
    START_IN_COLLISION = "start in collision"
    GOAL_IN_COLLISION = "goal in collision"
    NO_PATH = "no collision-free path found"
    LINE_OUT_OF_REACH = "straight line leaves the joint limits or the reach"
    LINE_IN_COLLISION = "straight line in collision"


@dataclass(frozen=True)
class PathResult:
    """A path, or why there is none.

    Attributes:
        status: SUCCESS or the reason.
        message: the reason in words, naming joints and bodies.
        trajectory: the timed motion; None unless successful.
        bodies: names of the two bodies in the way, None if none is to blame.
        configuration: (n,) where that happened, radians.
        stats: "method" (how it was found), "clearance" (smallest certified distance met, metres), "iterations",
            "seconds".
    """

    status: PathStatus
    message: str = ""
    trajectory: Trajectory | None = None
    bodies: tuple[str, str] | None = None
    configuration: Float[np.ndarray, " n"] | None = None
    stats: dict[str, float | str] = field(default_factory=dict)

    @property
    def success(self) -> bool:
        """Whether there is a trajectory."""
        return self.status is PathStatus.SUCCESS


def plan_path(query: PathQuery, seed: int = 0) -> PathResult:
    """A collision-free, smooth motion from start to goal, from rest to rest within the limits.

    Args:
        query: from where to where, among what.
        seed: seed of the random guesses and the search.

    Raises:
        ValueError: for configurations of the wrong shape or not finite. Everything else is a status.
    """
    began = time.perf_counter()
    start, goal = (query.space.configuration(q) for q in (query.start, query.goal))
    result = _plan(replace(query, start=start, goal=goal), seed)
    result.stats["seconds"] = time.perf_counter() - began
    return result


def cartesian_path(query: LineQuery) -> PathResult:
    """Move the gripper along a straight line with fixed orientation: approach, lift, lower, retreat.

    Args:
        query: from where and how far, among what.

    Raises:
        ValueError: for arrays of the wrong shape or not finite.
    """
    began = time.perf_counter()
    displacement = np.asarray(query.displacement, float)
    if displacement.shape != (3,) or not np.isfinite(displacement).all():
        raise ValueError(f"displacement must be 3 finite metres, got {displacement}")
    result = _follow(replace(query, start=query.space.configuration(query.start), displacement=displacement))
    result.stats["seconds"] = time.perf_counter() - began
    return result


def _plan(query: PathQuery, seed: int) -> PathResult:
    space, options = query.space, query.options
    clearance = path_clearance(space, extra_margin=_SLACK)
    failure = _end_failure(clearance, query.start, PathStatus.START_IN_COLLISION, options.contact_tolerance)
    if failure is None:
        failure = _end_failure(clearance, query.goal, PathStatus.GOAL_IN_COLLISION, _held_contact(space, options))
    if failure is not None:
        return failure
    query = replace(query, start=space.clipped(query.start), goal=space.clipped(query.goal))
    iterations, collision = 0, None
    between = clearance.between(query.start, query.goal)
    for attempt in path_attempts(query, between, np.random.default_rng(seed)):
        iterations += attempt.iterations
        if attempt.trajectory is not None:
            return _success(attempt, iterations)
        collision = attempt.collision or collision
    return _failure(space, PathStatus.NO_PATH, collision, iterations)


def _follow(query: LineQuery) -> PathResult:
    space, start, options = query.space, query.start, query.options
    clearance = path_clearance(space, extra_margin=_SLACK)
    failure = _end_failure(clearance, start, PathStatus.START_IN_COLLISION, options.contact_tolerance)
    if failure is not None:
        return failure
    start = space.clipped(start)
    line = follow_line(space.kinematics, start, query.displacement)
    if line.fraction < 1.0:
        return _out_of_reach(space, line, float(np.linalg.norm(query.displacement)))
    goal = line.configurations[-1]
    failure = _end_failure(clearance, goal, PathStatus.LINE_IN_COLLISION, _held_contact(space, options))
    if failure is not None:
        return failure
    several = len(line.configurations) > 1
    path = interpolating_path(line.configurations) if several else bspline(np.repeat(start[None], 5, axis=0))
    attempt = timed_attempt(clearance.between(start, goal), path, options, "line")
    if attempt.trajectory is not None:
        return _success(attempt, 0)
    return _failure(space, PathStatus.LINE_IN_COLLISION, attempt.collision)


def _success(attempt: Attempt, iterations: int) -> PathResult:
    stats = {"iterations": iterations, "method": attempt.method, "clearance": attempt.clearance}
    return PathResult(PathStatus.SUCCESS, trajectory=attempt.trajectory, stats=stats)


def _failure(
    space: ConfigurationSpace, status: PathStatus, collision: Collision | None, iterations: int = 0
) -> PathResult:
    stats: dict[str, float | str] = {"iterations": iterations}
    if collision is None:
        return PathResult(status, status.value, stats=stats)
    model = space.model
    a, b = (model.body_names[i] for i in model.pairs[collision.pair])
    apart = 1e3 * collision.distance * model.arrays.robot.unit
    message = f"{status.value}: {a!r} and {b!r} are {apart:.1f} mm apart"
    return PathResult(status, message, None, (a, b), collision.configuration, stats)


def _out_of_reach(space: ConfigurationSpace, line: Line, length: float) -> PathResult:
    done = line.fraction * length * space.model.arrays.robot.unit
    cause = "the arm does not reach further"
    if line.limiting_joint is not None:
        cause = f"joint {space.arm.joint_names[line.limiting_joint]!r} reaches its limit"
    status = PathStatus.LINE_OUT_OF_REACH
    message = f"{status.value}: {cause} after {done * 1e3:.0f} mm"
    return PathResult(status, message, configuration=line.configurations[-1], stats={"iterations": 0})


def _held_contact(space: ConfigurationSpace, options: PathOptions) -> Float[np.ndarray, " P"]:
    """Overlap (P,) allowed to each pair at the end of a path, metres: only what is held may touch."""
    held = np.array([name == "held" for name in space.model.body_names])[space.model.pairs].any(axis=1)
    return np.where(held, options.contact_tolerance, 0.0)


def _end_failure(
    clearance: PathClearance,
    q: Float[np.ndarray, " n"],
    status: PathStatus,
    allowed: float | Float[np.ndarray, " P"],
) -> PathResult | None:
    """Why an end of a path is outside the limits or, with this ``status``, overlaps by more than is ``allowed``."""
    space = clearance.space
    outside = np.flatnonzero((q < space.lower - 1e-6) | (q > space.upper + 1e-6))
    if len(outside):
        j, limits = int(outside[0]), PathStatus.OUT_OF_LIMITS
        span = f"[{space.lower[j]:.4f}, {space.upper[j]:.4f}]"
        joint = f"joint {space.arm.joint_names[j]!r} is at {q[j]:.4f} rad, limits {span}"
        return PathResult(limits, f"{limits.value}: {joint}", stats={"iterations": 0})
    collision = clearance.deepest_overlap(q[None], allowed)
    return None if collision is None else _failure(space, status, collision)
