from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp_planner.path.optimizer import Rows, bspline, fit_control_points, optimize_path, smoothness_form

LOWER, UPPER = np.full(2, -3.0), np.full(2, 3.0)
SAMPLES = np.linspace(0, 1, 64)[1:-1]


def discs(centers, radii):
    """Clearance rows of a point among discs in the plane."""

    def rows(q, reach):
        away = q[:, None] - centers
        length = np.linalg.norm(away, axis=2)
        clearance = length - radii
        i, p = np.nonzero(clearance < reach)
        return Rows(i, p, clearance[i, p], away[i, p] / length[i, p][:, None])

    return rows


def solve(rows, pairs, start=(0.0, 0.0), goal=(2.0, 0.0), count=24, lower=LOWER, upper=UPPER):
    line = np.array([start, goal])
    return optimize_path(fit_control_points(line, count), rows, SAMPLES, pairs, lower, upper)


def test_without_obstacles_the_straight_line_is_best():
    result = solve(discs(np.zeros((0, 2)), np.zeros(0)), 1)
    q = result.path(np.linspace(0, 1, 101))
    assert result.feasible
    np.testing.assert_allclose(q[:, 1], 0.0, atol=1e-6)
    assert result.cost == pytest.approx(2.0, rel=1e-3)  # ½ |goal − start|²


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_paths_among_discs_are_free_and_no_longer_than_needed(seed):
    rng = np.random.default_rng(seed)
    centers = np.array([[0.5, 0.0], [1.0, -0.35], [1.5, 0.2]]) + rng.uniform(-0.12, 0.12, (3, 2))
    radii = rng.uniform(0.1, 0.25, 3)
    result = solve(discs(centers, radii), 3)
    q = result.path(np.linspace(0, 1, 1000))
    assert result.feasible
    assert (np.linalg.norm(q[:, None] - centers, axis=2) - radii).min() > -5e-3  # samples are 3 cm apart
    np.testing.assert_allclose(q[[0, -1]], [[0, 0], [2, 0]], atol=1e-12)
    # Three discs of at most 25 cm cost no more than some half circles.
    assert np.linalg.norm(np.diff(q, axis=0), axis=1).sum() < 2 + 3 * 0.25 * np.pi


def test_one_disc_costs_what_the_taut_string_says():
    """Shortest way round a disc: two tangents and an arc."""
    radius = 0.3
    result = solve(discs(np.array([[1.0, 0.02]]), np.array([radius])), 1)
    tangent = np.sqrt(1 - radius**2)
    shortest = 2 * tangent + radius * (np.pi - 2 * np.arccos(radius))
    length = np.linalg.norm(np.diff(result.path(np.linspace(0, 1, 1000)), axis=0), axis=1).sum()
    assert length < 1.02 * shortest


def test_limits_hold_even_when_the_way_round_leads_along_them():
    lower, upper = np.array([-3.0, -0.05]), np.array([3.0, 0.45])
    result = solve(discs(np.array([[1.0, 0.0]]), np.array([0.3])), 1, lower=lower, upper=upper)
    q = result.path(np.linspace(0, 1, 1000))
    assert result.feasible
    assert (q >= lower - 1e-9).all()
    assert (q <= upper + 1e-9).all()


@pytest.mark.parametrize("count", [6, 24])
def test_objective_is_the_integral_it_claims_to_be(count):
    rng = np.random.default_rng(count)
    points = rng.normal(size=(count, 3))
    path = bspline(points)
    s = (np.arange(200000) + 0.5) / 200000
    integral = 0.5 * (path(s, 1) ** 2).sum(axis=1).mean() + 0.5 * 6e-3 * (path(s, 2) ** 2).sum(axis=1).mean()
    assert 0.5 * np.sum(points * (smoothness_form(count) @ points)) == pytest.approx(integral, rel=1e-6)


def test_fitting_keeps_the_ends_and_follows_the_polyline():
    polyline = np.array([[0, 0], [1, 0.5], [1.5, -0.5], [2.0, 0]])
    points = fit_control_points(polyline, 24)
    np.testing.assert_array_equal(points[[0, -1]], polyline[[0, -1]])
    q = bspline(points)(np.linspace(0, 1, 500))
    on_line = np.concatenate([a + np.linspace(0, 1, 200)[:, None] * (b - a) for a, b in pairwise(polyline)])
    assert max(np.linalg.norm(on_line - p, axis=1).min() for p in q) < 0.05
