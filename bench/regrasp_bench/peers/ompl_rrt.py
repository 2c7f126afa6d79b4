"""RRT-Connect of OMPL as a peer of PathPlan, with collisions by coal."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from regrasp_bench.peers.coal_checker import JOINT_STEP, ExactChecker, Path
from regrasp_bench.peers.optional import import_peer


@dataclass(frozen=True)
class RrtResult:
    """Outcome of OMPL.

    Attributes:
        waypoints: (K, n) corners of the simplified path, radians; None if none was found in time.
        seconds: time of the search alone.
        simplify_seconds: time of OMPL's path simplification after it.
        checked: number of configurations checked for collisions.
    """

    waypoints: Float[np.ndarray, "K n"] | None
    seconds: float
    simplify_seconds: float
    checked: int


def rrt_connect(
    checker: ExactChecker,
    start: Float[np.ndarray, " n"],
    goal: Float[np.ndarray, " n"],
    time_limit: float,
) -> RrtResult:
    """Search and simplify. Motions are checked at each degree of the joint that turns most, in batches.

    Args:
        checker: tells which configurations are free, and the joint limits.
        start, goal: (n,) free configurations, radians.
        time_limit: time limit of the search, seconds.

    Raises:
        BenchError: OMPL is not installed.
    """
    base, geometric = import_peer("ompl.base"), import_peer("ompl.geometric")
    util = import_peer("ompl.util")
    util.setLogLevel(util.LOG_NONE)
    dof = len(start)
    bounds = base.RealVectorBounds(dof)
    for i in range(dof):
        bounds.setLow(i, float(checker.lower[i]))
        bounds.setHigh(i, float(checker.upper[i]))
    space = base.RealVectorStateSpace(dof)
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    information = setup.getSpaceInformation()
    # The validator gets a space information of its own, which it never uses. With the same one, the two would
    # reference each other and never be freed.
    motions = _motion_validator(base, base.SpaceInformation(space), checker, dof)
    information.setMotionValidator(motions)
    setup.setStateValidityChecker(lambda state: motions.free(_array(state, dof)[None]))
    states = [space.allocState() for _ in range(2)]
    for state, q in zip(states, (start, goal), strict=True):
        state[0:dof] = [float(angle) for angle in np.clip(q, checker.lower, checker.upper)]
    setup.setStartAndGoalStates(*states)
    setup.setPlanner(geometric.RRTConnect(information))
    setup.setup()

    began = time.perf_counter()
    setup.solve(time_limit)
    found = time.perf_counter()
    waypoints = None
    if setup.haveExactSolutionPath():
        setup.simplifySolution()
        path = setup.getSolutionPath()
        waypoints = np.array([_array(path.getState(i), dof) for i in range(path.getStateCount())])
    ended = time.perf_counter()
    return RrtResult(waypoints, found - began, ended - found, motions.checked)


def polyline(waypoints: Float[np.ndarray, "K n"]) -> Path:
    """The path along the corners, by share of its length."""
    chord = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    at = np.append(0.0, np.cumsum(chord)) / max(chord.sum(), 1e-12)
    return lambda u: np.stack([np.interp(u, at, column) for column in waypoints.T], axis=1)


def _array(state: Any, dof: int) -> Float[np.ndarray, " n"]:
    return np.array(state[0:dof])


def _motion_validator(base: Any, information: Any, checker: ExactChecker, dof: int) -> Any:
    class MotionValidator(base.MotionValidator):
        """Checks straight motions: the end first, then every eighth configuration, then ever finer batches."""

        def __init__(self) -> None:
            super().__init__(information)
            self.checked = 0

        def checkMotion(self, first: Any, second: Any) -> bool:
            a, b = _array(first, dof), _array(second, dof)
            count = max(int(np.ceil(np.abs(b - a).max() / JOINT_STEP)), 1)
            q = a + (np.arange(1, count + 1) / count)[:, None] * (b - a)
            inner = q[:-1]
            parts = [q[-1:], inner[7::8], inner[3::8], inner[1::4], inner[::2]]
            return all(self.free(part) for part in parts)

        def free(self, q: Float[np.ndarray, "N n"]) -> bool:
            self.checked += len(q)
            return len(q) == 0 or checker.free(q)

    return MotionValidator()
