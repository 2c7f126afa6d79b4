"""Options of the path planner."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PathOptions:
    """Options of `plan_path` and `cartesian_path`.

    Attributes:
        control_points: control points of the spline, ends included.
        samples_per_interval: clearance samples in each knot interval of the spline.
        max_guesses: initial guesses to optimise before the search.
        max_iterations: constraint evaluations per guess.
        search_rounds: rounds of RRT-Connect; 0 turns it off.
        velocity_scale, acceleration_scale: fractions of the arm's limits to use.
        contact_tolerance: overlap allowed at the start, and for the held body at the goal too, metres. The robot starts
            where it is, and an object that stands on a surface touches it.
    """

    control_points: int = 24
    samples_per_interval: int = 3
    max_guesses: int = 4
    max_iterations: int = 30
    search_rounds: int = 200
    velocity_scale: float = 0.5
    acceleration_scale: float = 0.5
    contact_tolerance: float = 1e-3
