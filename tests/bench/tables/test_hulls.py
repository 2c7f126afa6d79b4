"""Random convex bodies."""

from __future__ import annotations

import numpy as np
import pytest

from regrasp_bench.tables.hulls import stone


def test_stones_are_what_they_say():
    widths = []
    for seed in range(30):
        thing = stone(seed)
        points = thing.pieces[0]
        assert 10 <= len(points) <= 60
        assert thing.mass == pytest.approx(2600 * volume(points))
        assert 0.03 <= np.ptp(points[:, 0]) <= 0.07
        widths.append(np.ptp(points, axis=0) / np.ptp(points[:, 0]))
    assert np.max(widths) < 3.6
    np.testing.assert_array_equal(stone(3).pieces[0], stone(3).pieces[0])
    assert not np.array_equal(stone(3).pieces[0][0], stone(4).pieces[0][0])


def volume(points):
    from scipy.spatial import ConvexHull

    return ConvexHull(points).volume
