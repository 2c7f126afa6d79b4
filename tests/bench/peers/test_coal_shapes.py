"""Exact collision checks with coal."""

from __future__ import annotations

import coal
import numpy as np
from scipy.spatial.transform import Rotation

import regrasp_gym  # noqa: F401
from regrasp_bench.peers.coal_shapes import PosedShapes, Shape, keeps_margins
from regrasp_planner import ConvexBody


def test_clear_says_what_the_distance_says():
    rng = np.random.default_rng(0)
    bodies = [ConvexBody.from_vertices(rng.normal(size=(12, 3)) * 0.05) for _ in range(4)]
    shapes = [Shape.of(body) for body in bodies]
    count, margin = 300, 0.01
    turns = Rotation.random(2 * (count + 1), random_state=1).as_matrix().reshape(-1, 2, 3, 3)
    shifts = rng.uniform(-0.2, 0.2, (count + 1, 2, 3))
    moving = PosedShapes(shapes[:2], turns[:count], shifts[:count])
    still = PosedShapes(shapes[2:], turns[count], shifts[count])
    expected = np.ones(count, bool)
    for i in range(count):
        for a in range(2):
            for b in range(2):
                distance = coal.distance(
                    shapes[a].geometry,
                    coal.Transform3s(turns[i, a], shifts[i, a]),
                    shapes[2 + b].geometry,
                    coal.Transform3s(turns[count, b], shifts[count, b]),
                    coal.DistanceRequest(),
                    coal.DistanceResult(),
                )
                expected[i] &= distance > margin
    assert 20 < expected.sum() < count - 20
    np.testing.assert_array_equal(keeps_margins(moving, still, margin), expected)


def test_the_sweep_counts():
    ball = Shape.of(ConvexBody.sphere(0.05))
    at = np.array([[[0.0, 0, 0.12]], [[0.0, 0, 0.09]]])
    turns = np.tile(np.eye(3), (2, 1, 1, 1))
    still = PosedShapes([ball], np.eye(3)[None], np.zeros((1, 3)))
    np.testing.assert_array_equal(keeps_margins(PosedShapes([ball], turns, at), still, 0.0), [True, False])
    np.testing.assert_array_equal(keeps_margins(PosedShapes([ball], turns, at), still, 0.03), [False, False])
