"""A trajectory cut into ever shorter intervals, with bounds of how far each joint turns in them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from regrasp_planner.path.trajectory import Trajectory


class Course:
    """Intervals of a trajectory, and how far each joint turns in them."""

    def __init__(self, trajectory: Trajectory):
        self.trajectory = trajectory
        pieces = self._within(trajectory.times[:-1], trajectory.times[1:])
        self._turned = np.concatenate([np.zeros_like(pieces[:1]), np.cumsum(pieces, axis=0)])

    def begin(self, count: int) -> tuple[Float[np.ndarray, " I"], Float[np.ndarray, " I"]]:
        """About ``count`` intervals that cover everything, even in the turn of the joints, between samples."""
        turned = self._turned.sum(axis=1)
        at = np.searchsorted(turned, np.linspace(0.0, turned[-1], count + 1))
        edges = np.unique(np.concatenate([[0], np.minimum(at, len(turned) - 1), [len(turned) - 1]]))
        return self.trajectory.times[edges[:-1]], self.trajectory.times[edges[1:]]

    def halved(
        self, begin: Float[np.ndarray, " I"], end: Float[np.ndarray, " I"]
    ) -> tuple[Float[np.ndarray, " J"], Float[np.ndarray, " J"]]:
        """Two intervals for each: split at a sample while there is one inside, in the middle of a piece after that."""
        first, last = self._samples(begin, end)
        middle = np.where(last - first > 1, self.trajectory.times[(first + last) // 2], 0.5 * (begin + end))
        return np.concatenate([begin, middle]), np.concatenate([middle, end])

    def variation(self, begin: Float[np.ndarray, " I"], end: Float[np.ndarray, " I"]) -> Float[np.ndarray, "I n"]:
        """Bound of each joint's total variation over each interval, radians."""
        first, last = self._samples(begin, end)
        several = last - first > 1
        out = self._turned[last] - self._turned[first]
        out[~several] = self._within(begin[~several], end[~several])
        return out

    def _samples(
        self, begin: Float[np.ndarray, " I"], end: Float[np.ndarray, " I"]
    ) -> tuple[Int[np.ndarray, " I"], Int[np.ndarray, " I"]]:
        times = self.trajectory.times
        return np.searchsorted(times, begin, side="right") - 1, np.searchsorted(times, end, side="left")

    def _within(self, begin: Float[np.ndarray, " I"], end: Float[np.ndarray, " I"]) -> Float[np.ndarray, "I n"]:
        """Length of the control polygon of the Hermite cubic, for intervals within one piece each."""
        q0, q1 = self.trajectory.at(begin), self.trajectory.at(end)
        third = (end - begin)[:, None] / 3
        c0 = q0 + third * self.trajectory.velocity_at(begin)
        c1 = q1 - third * self.trajectory.velocity_at(end)
        return np.abs(c0 - q0) + np.abs(c1 - c0) + np.abs(q1 - c1)
