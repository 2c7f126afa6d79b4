"""Facets that a stone may lie on, against statics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from regrasp_gym.objects.stones import stone
from regrasp_gym.scenes.slope_resting import SHORTEST_EDGE, seats


@pytest.mark.parametrize("seed", range(10))
def test_seats_rest_and_tip_where_statics_says(seed) -> None:
    model = stone(seed)
    fall = np.array([0.2, 0.1])
    for seat in seats(model):
        placed = model.pieces[0] @ seat.rotation.T
        assert placed[:, 2].min() == pytest.approx(-seat.height)
        touching = placed[placed[:, 2] < -seat.height + 1e-7][:, :2]
        assert {tuple(p) for p in touching.round(6) + 0.0} == {tuple(p) for p in seat.corners.round(6) + 0.0}
        edges = np.linalg.norm(seat.corners - np.roll(seat.corners, 1, axis=0), axis=1)
        assert edges.min() >= SHORTEST_EDGE
        for yaw in (0.0, 1.0, -2.5):
            c, s = np.cos(yaw), np.sin(yaw)
            equations = ConvexHull(touching @ np.array([[c, s], [-s, c]])).equations
            expected = -(equations[:, :2] @ (seat.height * fall) + equations[:, 2]).max()
            assert seat.margin(np.array([yaw]), fall)[0] == pytest.approx(expected)
