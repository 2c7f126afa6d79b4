"""Timed joint trajectories, and the fastest timing of a geometric path within velocity and acceleration limits."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import BSpline, CubicHermiteSpline, make_interp_spline

from regrasp_planner.path.polyline import chord_lengths

_GRID_SPACING = 0.01
"""Path length between two grid points of the time parametrisation, radians (largest joint)."""
_MIN_GRID, _MAX_GRID = 40, 400


@dataclass(frozen=True)
class Trajectory:
    """Joint motion over time: a C¹ cubic Hermite spline through samples of position and velocity.

    The samples need not be evenly spaced; `resampled` gives an even grid for a controller.

    Attributes:
        times: (T,) seconds, increasing, from 0.
        positions: (T, n) radians.
        velocities: (T, n) rad/s.
    """

    times: Float[np.ndarray, " T"]
    positions: Float[np.ndarray, "T n"]
    velocities: Float[np.ndarray, "T n"]

    def __post_init__(self):
        shape = self.positions.shape
        if len(shape) != 2 or self.times.shape != shape[:1] or self.velocities.shape != shape or shape[0] < 2:
            raise ValueError(
                f"trajectory needs times (T,), positions (T, n), velocities (T, n) with T ≥ 2; "
                f"got {self.times.shape}, {shape}, {self.velocities.shape}"
            )
        if not (np.diff(self.times) > 0).all():
            raise ValueError("trajectory times must increase")

    @property
    def duration(self) -> float:
        """Seconds from the first to the last sample."""
        return float(self.times[-1] - self.times[0])

    @property
    def start(self) -> Float[np.ndarray, " n"]:
        """First configuration, (n,) radians."""
        return self.positions[0]

    @property
    def goal(self) -> Float[np.ndarray, " n"]:
        """Last configuration, (n,) radians."""
        return self.positions[-1]

    def at(self, t: float | Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch n"]:
        """Positions at time t (seconds), held at the ends outside the time span; (n,) for a scalar, (m, n) for (m,)."""
        return self._spline(np.clip(t, self.times[0], self.times[-1]))

    def velocity_at(self, t: float | Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch n"]:
        """Velocities at time t, rad/s; zero outside the time span."""
        return self._derivative_at(t, 1)

    def acceleration_at(self, t: float | Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch n"]:
        """Accelerations at time t, rad/s²; zero outside the time span, from the right where they jump."""
        return self._derivative_at(t, 2)

    @cached_property
    def _spline(self) -> CubicHermiteSpline:
        return CubicHermiteSpline(self.times, self.positions, self.velocities)

    def _derivative_at(self, t: float | Float[np.ndarray, "*batch"], order: int) -> Float[np.ndarray, "*batch n"]:
        t = np.asarray(t, float)
        inside = ((t >= self.times[0]) & (t <= self.times[-1]))[..., None]
        return np.where(inside, self._spline(t, order), 0.0)

    def resampled(self, dt: float) -> Trajectory:
        """The same motion sampled every ``dt`` seconds; the last sample is the end of the motion, at most dt later."""
        steps = max(int(np.ceil(self.duration / dt - 1e-9)), 1)
        t = self.times[0] + np.minimum(np.arange(steps + 1) * dt, self.duration)
        t[-1] = self.times[-1]
        return Trajectory(t - t[0], self.at(t), self.velocity_at(t))

    def stretched(self, factor: float) -> Trajectory:
        """The same path in ``factor`` times the time."""
        return Trajectory(self.times * factor, self.positions, self.velocities / factor)

    def reversed(self) -> Trajectory:
        """The same path backwards."""
        return Trajectory(self.times[-1] - self.times[::-1], self.positions[::-1].copy(), -self.velocities[::-1])

    def peak_ratios(
        self, max_velocity: Float[np.ndarray, " n"], max_acceleration: Float[np.ndarray, " n"]
    ) -> tuple[float, float]:
        """Largest |velocity| and |acceleration| over the whole motion, as fractions of the limits.

        Exact: velocity is quadratic and acceleration linear in each interval, so their extremes are at the interval's
        ends and, for the velocity, where the acceleration vanishes.
        """
        h = np.diff(self.times)[:, None]
        step = np.diff(self.positions, axis=0)
        v0, v1 = self.velocities[:-1], self.velocities[1:]
        a0 = (6 * step / h - 4 * v0 - 2 * v1) / h
        a1 = (-6 * step / h + 2 * v0 + 4 * v1) / h
        acceleration = np.maximum(np.abs(a0), np.abs(a1))
        slope = a1 - a0
        u = np.clip(np.divide(-a0, slope, out=np.zeros_like(a0), where=slope != 0), 0.0, 1.0)
        inner = v0 + h * u * (a0 + 0.5 * slope * u)
        velocity = np.maximum(np.maximum(np.abs(v0), np.abs(v1)), np.abs(inner))
        return float((velocity / max_velocity).max()), float((acceleration / max_acceleration).max())


class TrajectoryIntervals:
    """Intervals of a trajectory, halved again and again, with bounds of how far each joint turns in them."""

    def __init__(self, trajectory: Trajectory):
        self.trajectory = trajectory
        pieces = self._within(trajectory.times[:-1], trajectory.times[1:])
        self._turned = np.concatenate([np.zeros_like(pieces[:1]), np.cumsum(pieces, axis=0)])

    def cover(self, count: int) -> tuple[Float[np.ndarray, " I"], Float[np.ndarray, " I"]]:
        """About ``count`` intervals from sample to sample that cover all; the joints turn about equally far in each."""
        turned = self._turned.sum(axis=1)
        at = np.searchsorted(turned, np.linspace(0.0, turned[-1], count + 1))
        edges = np.unique(np.concatenate([[0], np.minimum(at, len(turned) - 1), [len(turned) - 1]]))
        return self.trajectory.times[edges[:-1]], self.trajectory.times[edges[1:]]

    def halved(
        self, begin: Float[np.ndarray, " I"], end: Float[np.ndarray, " I"]
    ) -> tuple[Float[np.ndarray, " J"], Float[np.ndarray, " J"]]:
        """Two intervals for each: split at a sample while there is one inside, then in the middle."""
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


def joined(pieces: Sequence[Trajectory]) -> Trajectory:
    """Trajectories one after another; each starts where the last one ended, at rest."""
    times, positions, velocities = [pieces[0].times], [pieces[0].positions], [pieces[0].velocities]
    for piece in pieces[1:]:
        times.append(times[-1][-1] + piece.times[1:])
        positions.append(piece.positions[1:])
        velocities.append(piece.velocities[1:])
    return Trajectory(np.concatenate(times), np.concatenate(positions), np.concatenate(velocities))


def interpolating_path(waypoints: Float[np.ndarray, "K n"]) -> BSpline:
    """C² cubic spline on [0, 1] through waypoints (K ≥ 2), parametrised by chord length.

    Raises:
        ValueError: if two neighbouring waypoints coincide.
    """
    waypoints = np.asarray(waypoints, float)
    lengths = chord_lengths(waypoints)
    if len(waypoints) < 2 or not (np.diff(lengths) > 0).all():
        raise ValueError("a path needs at least two waypoints, no two neighbours equal")
    s = lengths / lengths[-1]
    degree = min(3, len(waypoints) - 1)
    conditions = "natural" if degree == 3 else None
    return make_interp_spline(s, waypoints, k=degree, bc_type=conditions)


def time_parametrize(
    path: BSpline,
    max_velocity: Float[np.ndarray, " n"],
    max_acceleration: Float[np.ndarray, " n"],
    velocity_scale: float = 0.5,
    acceleration_scale: float = 0.5,
) -> Trajectory:
    """Fastest motion along a path, from rest to rest, within velocity and acceleration limits.

    TOPP-RA (Pham and Pham, IEEE T-RO 2018) gives the path speed on a grid; between two grid points the path
    acceleration is constant, and the grid points become the samples of the trajectory. What the grid misses between
    its points is removed by slowing the whole motion down by the measured excess, so the limits hold everywhere.

    Args:
        path: joint positions over [0, 1], (n,) radians each, C² or piecewise linear with one piece.
        max_velocity: (n,) rad/s.
        max_acceleration: (n,) rad/s².
        velocity_scale, acceleration_scale: fractions of the limits to use, in (0, 1].

    Raises:
        ValueError: for scales outside (0, 1].
        ArithmeticError: if no timing exists (a path that is not smooth).
    """
    if not (0 < velocity_scale <= 1 and 0 < acceleration_scale <= 1):
        raise ValueError(f"limit scales must be in (0, 1], got {velocity_scale} and {acceleration_scale}")
    velocity = np.asarray(max_velocity, float) * velocity_scale
    acceleration = np.asarray(max_acceleration, float) * acceleration_scale
    low, high = path.t[path.k], path.t[-path.k - 1]
    probe = np.asarray(path(np.linspace(low, high, _MIN_GRID + 1)))
    length = np.abs(np.diff(probe, axis=0)).max(axis=1).sum()
    if length < 1e-9:
        ends = np.asarray(path(np.array([low, high])))
        return Trajectory(np.array([0.0, 1e-2]), ends, np.zeros_like(ends))
    count = int(np.clip(np.ceil(length / _GRID_SPACING), _MIN_GRID, _MAX_GRID))
    grid = _grid(low, high, count)
    speed = _path_speed(path, grid, velocity, acceleration)
    times = np.concatenate([[0.0], np.cumsum(2 * np.diff(grid) / (speed[:-1] + speed[1:]))])
    trajectory = Trajectory(times, np.asarray(path(grid)), np.asarray(path(grid, 1)) * speed[:, None])
    velocity_ratio, acceleration_ratio = trajectory.peak_ratios(velocity, acceleration)
    return trajectory.stretched(max(1.0, velocity_ratio, np.sqrt(acceleration_ratio)))


def _grid(low: float, high: float, count: int) -> Float[np.ndarray, " N"]:
    """Grid denser (quadratically) near the ends, where the motion starts from rest and time per path length is long."""
    u = np.linspace(0.0, 1.0, count + 1)
    edge = 0.1
    # Quadratic in [0, edge] and its mirror image, linear between, C¹ where they meet.
    ramp = np.where(u < edge, u**2 / (2 * edge), u - edge / 2)
    ramp = np.where(u > 1 - edge, (1 - edge) - (1 - u) ** 2 / (2 * edge), ramp)
    return low + (high - low) * ramp / ramp[-1]


def _path_speed(
    path: BSpline,
    grid: Float[np.ndarray, " N"],
    velocity: Float[np.ndarray, " n"],
    acceleration: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " N"]:
    """Path speed ds/dt on the grid, zero at both ends (TOPP-RA)."""
    # toppra imports matplotlib and reports its choice of solver: neither belongs to importing this module.
    logging.getLogger("toppra").setLevel(logging.WARNING)
    from toppra import algorithm, constraint, interpolator

    class SplinePath(interpolator.AbstractGeometricPath):  # type: ignore[misc]
        def __call__(self, path_positions: float | Float[np.ndarray, " N"], order: int = 0) -> Float[np.ndarray, "N n"]:
            return path(path_positions, order)

        @property
        def dof(self) -> int:
            return len(velocity)

        @property
        def path_interval(self) -> Float[np.ndarray, 2]:
            return grid[[0, -1]]

    limits = [
        constraint.JointVelocityConstraint(np.stack([-velocity, velocity], axis=1)),
        constraint.JointAccelerationConstraint(
            np.stack([-acceleration, acceleration], axis=1),
            discretization_scheme=constraint.DiscretizationType.Interpolation,
        ),
    ]
    solver = algorithm.TOPPRA(limits, SplinePath(), gridpoints=grid, solver_wrapper="seidel")
    speed = solver.compute_parameterization(0.0, 0.0)[1]
    if speed is None or not np.isfinite(speed).all():
        raise ArithmeticError("no timing within the limits exists for this path")
    return np.maximum(speed, 0.0)
