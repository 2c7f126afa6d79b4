from __future__ import annotations

import numpy as np
import pytest
from hulls import hull_distance
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, QhullError

from regrasp_gym.geometry.polygons import clearance, footprint_gap, slide_apart


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_gap_never_exceeds_distance_and_tells_overlap(seed):
    rng = np.random.default_rng(seed)
    polygons = []
    for shift in (np.zeros(2), rng.uniform(-2.5, 2.5, 2)):
        points = rng.normal(size=(8, 2)) * 0.6 + shift
        try:
            polygons.append(points[ConvexHull(points).vertices])
        except QhullError:
            return
    a, b = polygons
    prisms = [np.concatenate([np.column_stack([p, np.full(len(p), z)]) for z in (0.0, 1.0)]) for p in polygons]
    distance = hull_distance(*prisms)
    gap = footprint_gap(a, b)
    assert gap <= max(distance, 0) + 1e-6 or distance < 0
    assert (gap > 1e-9) == (distance > 1e-9) or abs(gap) < 1e-6
    assert footprint_gap(np.stack([a, a]), b) == pytest.approx([gap, gap])


@pytest.mark.parametrize("seed", range(30))
def test_sliding_apart_leaves_exactly_the_gap(seed) -> None:
    rng = np.random.default_rng(seed)
    try:
        a, b = (points[ConvexHull(points).vertices] for points in rng.normal(size=(2, 7, 2)))
    except QhullError:
        pytest.skip("no polygon")
    angles = rng.uniform(-np.pi, np.pi, 20)
    ways = np.column_stack([np.cos(angles), np.sin(angles)])
    slid = slide_apart(np.broadcast_to(a, (20, *a.shape)), ways, b, 0.1)
    gaps = footprint_gap(a + slid[:, None, None] * ways[:, None], b)
    assert (gaps >= 0.1 - 1e-9).all()
    assert gaps[slid > 0] == pytest.approx(0.1)
    further = footprint_gap(a + (slid + 0.3)[:, None, None] * ways[:, None], b)
    assert (further >= 0.1).all()
    assert clearance(b, b.mean(axis=0)) > 0 > clearance(b, b[0] + 10)
