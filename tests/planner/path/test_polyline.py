import numpy as np
from scipy.spatial.distance import cdist

from regrasp_planner.path.polyline import chord_lengths, inner_points, points_at

CORNER = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]])


def test_lengths_add_up_along_the_chords():
    np.testing.assert_allclose(chord_lengths(CORNER), [0, 3, 7])
    np.testing.assert_array_equal(chord_lengths(CORNER[:1]), [0])


def test_points_lie_at_their_length_and_at_the_ends_beyond():
    np.testing.assert_allclose(points_at(CORNER, np.array([1.0, 3.0, 5.0])), [[1, 0], [3, 0], [3, 2]])
    np.testing.assert_allclose(points_at(CORNER, np.array([[-1.0, 8.0]])), CORNER[None, [0, -1]])


def test_inner_points_are_even_and_leave_the_ends_out():
    points = inner_points(CORNER, 6)
    np.testing.assert_allclose(chord_lengths(np.concatenate([CORNER[:1], points])), np.arange(7), atol=1e-12)
    assert cdist(points, CORNER[[0, -1]]).min() > 0.9


def test_a_polyline_without_length_is_one_point():
    rest = np.repeat(CORNER[1:2], 3, axis=0)
    np.testing.assert_array_equal(inner_points(rest, 2), rest[:2])
