"""A certificate that a timed motion touches nothing, between its samples either."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from regrasp_planner.path.clearance import Collision, PathClearance, collision_at
from regrasp_planner.path.trajectory import Trajectory, TrajectoryIntervals

_COARSE = 48
"""Intervals that the check begins with."""
_MAX_DEPTH = 14
_FINEST = 5e-4
"""Motion (metres) between neighbouring checked configurations below which a contact pair needs no certificate."""


class _Check(NamedTuple):
    """Outcome for some intervals.

    Attributes:
        clearance: smallest certified distance met, metres.
        doubtful: (I,) the intervals left open.
        collision: a collision, or None.
    """

    clearance: float
    doubtful: Bool[np.ndarray, " I"]
    collision: Collision | None


def certify(clearance: PathClearance, trajectory: Trajectory) -> tuple[Collision | None, float]:
    """Check a whole trajectory, between its samples too, against the exact hulls.

    On the way through an interval two bodies can close in by m₀ from its beginning and by m₁ from its end, with
    m₀ + m₁ ≤ M, the bound of their motion over the interval (joints' variation from the control polygon of the Hermite
    cubic). So they cannot touch if their distances at the two ends sum to more than M. Intervals that do not pass are
    halved. A pair already closer than its margin at an end of the path cannot pass at that end. For it, and only while
    its margin is relieved there, it is enough that configurations no more than 0.5 mm of motion apart do not overlap,
    or, if the end itself does, not by 0.2 mm more than the end.

    Returns:
        A collision (None: the path is free), and the smallest certified distance met outside the relieved pairs,
        metres (inf where nothing came near).
    """
    intervals = TrajectoryIntervals(trajectory)
    begin, end = intervals.cover(_COARSE)
    nearest = np.inf
    for depth in range(_MAX_DEPTH + 1):
        check = _check_intervals(clearance, intervals, begin, end, depth == _MAX_DEPTH)
        nearest = min(nearest, check.clearance)
        if check.collision is not None or not check.doubtful.any():
            return check.collision, nearest
        begin, end = intervals.halved(begin[check.doubtful], end[check.doubtful])
    raise AssertionError("the last depth decides every interval")


def _check_intervals(
    clearance: PathClearance,
    intervals: TrajectoryIntervals,
    begin: Float[np.ndarray, " I"],
    end: Float[np.ndarray, " I"],
    last: bool,
) -> _Check:
    times, where = np.unique(np.concatenate([begin, end]), return_inverse=True)
    left, right = where[: len(begin)], where[len(begin) :]
    q = intervals.trajectory.at(times)
    at = clearance.pairs.bounds(q)
    relieved = clearance.contact_floor(q)
    floor = np.where(np.isfinite(relieved), relieved, clearance.floor)
    # Slack above touching, from the cheap bounds first.
    slack = np.where(clearance.valid, at.bounds - clearance.floor, np.inf)
    motion = clearance.pairs.motion(at.radius[left], intervals.variation(begin, end))
    near = slack[left] + slack[right] <= motion
    needed = slack < 0
    np.logical_or.at(needed, left, near)
    np.logical_or.at(needed, right, near)
    sample, pair = np.nonzero(needed)
    found = clearance.pairs.measure(at, sample, pair)
    slack[sample, pair] = found.certified - clearance.floor[pair]
    plain = ~np.isfinite(relieved[sample, pair])
    closest = float(found.certified[plain].min(initial=np.inf))
    hit = np.flatnonzero(found.certified < floor[sample, pair])
    if len(hit):
        first = int(hit[np.argmin(times[sample[hit]])])
        return _Check(closest, np.zeros(len(begin), bool), collision_at(found, first, q))
    passed = slack[left] + slack[right] > motion
    passed |= np.isfinite(relieved[left]) & np.isfinite(relieved[right]) & (motion < _FINEST)
    doubtful: Bool[np.ndarray, " I"] = np.logical_not(passed.all(axis=1))
    if last and doubtful.any():
        i = int(np.flatnonzero(doubtful)[0])
        k = int(np.where(passed[i], np.inf, slack[left[i]]).argmin())
        certain = float(slack[left[i], k] + clearance.floor[k])
        return _Check(closest, doubtful, Collision(k, q[left[i]], certain))
    return _Check(closest, doubtful, None)
