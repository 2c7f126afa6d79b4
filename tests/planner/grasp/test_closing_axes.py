"""Closing axes of known bodies, and against descent of the width function."""

import numpy as np
import pytest
from scipy.optimize import nnls

from regrasp_planner.grasp.closing_axes import closing_axes
from regrasp_planner.grasp.grasp import GraspGenOptions

OPTIONS = GraspGenOptions()


def test_closing_axes_of_a_box_are_its_narrow_directions(bodies):
    hull = bodies.box().hull_vertices()
    axes, widths = closing_axes(hull, 0.08, OPTIONS.max_axes)
    assert len(axes) == 1
    np.testing.assert_allclose(np.abs(axes[0]), [1, 0, 0], atol=1e-12)
    assert widths[0] == pytest.approx(bodies.size[0])
    axes, widths = closing_axes(hull, 0.2, OPTIONS.max_axes)
    np.testing.assert_allclose(np.abs(axes), np.eye(3), atol=1e-12)
    np.testing.assert_allclose(widths, bodies.size)


def test_closing_axes_of_a_can_spread_around_it(bodies):
    axes, widths = closing_axes(bodies.can().hull_vertices(), 0.08, OPTIONS.max_axes)
    assert 6 <= len(axes) <= OPTIONS.max_axes
    np.testing.assert_allclose(axes[:, 2], 0, atol=1e-9)
    np.testing.assert_allclose(widths, 2 * 0.033 * np.cos(np.pi / 24))
    directions = np.sort(np.degrees(np.arctan2(axes[:, 1], axes[:, 0])) % 180)
    assert np.diff(directions, append=directions[0] + 180).max() < 45


@pytest.mark.parametrize("seed", range(5))
def test_closing_axes_are_the_local_minima_of_the_width(seed):
    """On random hulls: no wider a step away, and descent from anywhere ends at one of them."""
    rng = np.random.default_rng(seed)
    hull = rng.normal(size=(20, 3)) * [0.02, 0.03, 0.04]
    axes, widths = closing_axes(hull, np.inf, 1000)

    def width(x):
        return np.ptp(hull @ np.asarray(x).T, axis=0)

    np.testing.assert_allclose(width(axes), widths)
    for axis, least in zip(axes, widths, strict=True):
        steps = axis + 1e-4 * rng.normal(size=(200, 3))
        assert (width(steps / np.linalg.norm(steps, axis=1, keepdims=True)) > least - 1e-12).all()
    starts = rng.normal(size=(40, 3))
    for x in starts / np.linalg.norm(starts, axis=1, keepdims=True):
        size = 0.3
        while size > 1e-5:
            trial = x + size * rng.normal(size=(60, 3))
            trial /= np.linalg.norm(trial, axis=1, keepdims=True)
            best = trial[width(trial).argmin()]
            x, size = (best, size) if width(best) < width(x) else (x, 0.7 * size)
        assert np.abs(axes @ x).max() > np.cos(np.radians(3.5))


@pytest.mark.parametrize("seed", range(5))
def test_leaning_axes_come_after_the_minima_and_lean_no_more_than_told(seed):
    hull = np.random.default_rng(seed).normal(size=(20, 3)) * [0.02, 0.03, 0.04]
    minima, widths = closing_axes(hull, np.inf, 1000)
    axes, all_widths = closing_axes(hull, np.inf, 1000, lean=0.25)
    assert len(axes) > len(minima)
    np.testing.assert_array_equal(axes[: len(minima)], minima)
    np.testing.assert_array_equal(all_widths[: len(minima)], widths)
    differences = (hull[:, None] - hull[None]).reshape(-1, 3)
    for k, (axis, width) in enumerate(zip(axes, all_widths, strict=True)):
        heights = differences @ axis
        assert heights.max() == pytest.approx(width)
        # The lines between contacts that this axis allows, and the one of them that leans least.
        between = differences[heights > width - 1e-9]
        assert np.linalg.matrix_rank(between[1:] - between[0], tol=1e-6) == 2
        weights, _ = nnls(np.vstack([between.T, 1e3 * np.ones(len(between))]), [0, 0, 0, 1e3])
        nearest = weights @ between
        leaning = np.arccos(np.clip(width / np.linalg.norm(nearest), -1, 1))
        # Beyond a corner of the facet it leans more than over the edge.
        assert leaning < (1e-3 if k < len(minima) else 2 * 0.25)
