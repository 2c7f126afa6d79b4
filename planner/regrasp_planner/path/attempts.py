"""Attempts at a joint-space path, from the least costly to the most: straight, optimised, searched."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline

from regrasp_planner.path.certificate import certify
from regrasp_planner.path.clearance import Collision, PathClearance
from regrasp_planner.path.guesses import initial_guesses, rank_guesses, retreats
from regrasp_planner.path.optimizer import Rows, bspline, fit_control_points, optimize_path
from regrasp_planner.path.options import PathOptions
from regrasp_planner.path.polyline import inner_points
from regrasp_planner.path.query import PathQuery
from regrasp_planner.path.rrt import rrt_connect, shortcut
from regrasp_planner.path.trajectory import Trajectory, joined, time_parametrize

_REFINEMENTS = 2
"""How often a path that collides between its samples is optimised again with more of them."""
_NEARLY = 3e-3
"""An optimised path that misses its clearance by less than this (metres) may still be free: the exact check decides."""


@dataclass(frozen=True)
class Attempt:
    """One attempt at a path.

    Attributes:
        method: how the path was made.
        trajectory: the timed motion, certified to be free; None if the attempt failed.
        collision: where it failed, if known.
        clearance: smallest certified distance met, metres.
        iterations: trust-region steps of the optimiser.
    """

    method: str
    trajectory: Trajectory | None = None
    collision: Collision | None = None
    clearance: float = np.inf
    iterations: int = 0


def path_attempts(query: PathQuery, clearance: PathClearance, rng: np.random.Generator) -> Iterator[Attempt]:
    """Attempts at a path from start to goal, each made only when it is asked for.

    Args:
        query: the query, its ends within the joint limits.
        clearance: the distances to keep, with the path's ends.
        rng: source of the random guesses and of the search.
    """
    start, goal, options = query.start, query.goal, query.options
    line = np.stack([start, goal])
    if clearance.free(inner_points(line, 24)).all():
        yield timed_attempt(clearance, _straight(line), options, "straight")
    guesses = rank_guesses(clearance, [line, *initial_guesses(clearance.space, start, goal, rng)])
    guesses = guesses[: options.max_guesses]
    half, rounds = len(guesses) // 2, options.search_rounds
    for some, share in ((guesses[:half], rounds // 4), (guesses[half:], rounds)):
        for guess in some:
            yield _optimized(clearance, guess, options, "optimised")
        if share:
            yield from _searched(query, clearance, rng, share)


def timed_attempt(clearance: PathClearance, path: BSpline, options: PathOptions, method: str) -> Attempt:
    """Time a path and check the timed motion exactly."""
    return _certified(clearance, _timed(clearance, path, options), method)


def _timed(clearance: PathClearance, path: BSpline, options: PathOptions) -> Trajectory:
    arm = clearance.space.arm
    velocity, acceleration = np.asarray(arm.max_velocity, float), np.asarray(arm.max_acceleration, float)
    return time_parametrize(path, velocity, acceleration, options.velocity_scale, options.acceleration_scale)


def _certified(clearance: PathClearance, trajectory: Trajectory, method: str) -> Attempt:
    collision, nearest = certify(clearance, trajectory)
    if collision is not None:
        return Attempt(method, collision=collision)
    return Attempt(method, trajectory, clearance=nearest)


def _straight(line: Float[np.ndarray, "2 n"]) -> BSpline:
    return bspline(fit_control_points(line, 8))


def _optimized(
    clearance: PathClearance, guess: Float[np.ndarray, "K n"], options: PathOptions, method: str, finer: int = 1
) -> Attempt:
    """Optimise a polyline into a path; with ``finer`` times as many control points."""
    space, count = clearance.space, finer * options.control_points
    points = space.clipped(fit_control_points(guess, count))
    samples = np.linspace(0.0, 1.0, options.samples_per_interval * (count - 3) + 1)[1:-1]

    def rows(q: Float[np.ndarray, "N n"], within: float) -> Rows:
        required = clearance.required(q)
        found = clearance.measure(q, required + within)
        slack = found.distance - required[found.sample, found.pair]
        keep = slack < within
        return Rows(found.sample[keep], found.pair[keep], slack[keep], found.gradient[keep])

    iterations, attempt = 0, Attempt(method)
    for _ in range(_REFINEMENTS + 1):
        outcome = optimize_path(
            points, rows, samples, len(clearance.margin), space.lower, space.upper, options.max_iterations
        )
        iterations += outcome.iterations
        if outcome.violation > _NEARLY:
            collision = clearance.deepest_overlap(outcome.path(samples)) or attempt.collision
            return Attempt(method, collision=collision, iterations=iterations)
        attempt = replace(timed_attempt(clearance, outcome.path, options, method), iterations=iterations)
        if attempt.collision is None:
            break
        # Something slipped through between samples: once more from here, with more of them about that place.
        dense = np.linspace(0.0, 1.0, 2001)
        hit = dense[np.linalg.norm(outcome.path(dense) - attempt.collision.configuration, axis=1).argmin()]
        more = hit + np.arange(-6, 7) / (4.0 * len(samples))
        samples = np.union1d(samples, np.clip(more, 1e-3, 1 - 1e-3))
        points = outcome.control_points
    return attempt


def _searched(query: PathQuery, clearance: PathClearance, rng: np.random.Generator, rounds: int) -> Iterator[Attempt]:
    """A polyline found by RRT-Connect and shortened: optimised, or as it is, with a rest at each corner."""
    start, goal, space, options = query.start, query.goal, query.space, query.options
    branches = [line[::6] for q in (start, goal) for line in retreats(space, q)]
    polyline = rrt_connect(
        start, goal, clearance.free, space.lower, space.upper, rng, max_rounds=rounds, branches=branches
    )
    if polyline is None:
        return
    polyline = shortcut(polyline, clearance.free, rng)
    for finer in (1, 2):
        yield _optimized(clearance, polyline, options, "searched", finer)
    edges = np.stack([polyline[:-1], polyline[1:]], axis=1)
    stopping = joined([_timed(clearance, _straight(edge), options) for edge in edges])
    yield _certified(clearance, stopping, "searched, with stops")
