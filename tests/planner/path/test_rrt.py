import numpy as np
import pytest

from regrasp_planner.path.polyline import inner_points
from regrasp_planner.path.rrt import rrt_connect, shortcut

LOWER, UPPER = np.full(3, -2.0), np.full(3, 2.5)


def two_walls(q, thinner=0.0):
    """Free outside two walls with gaps at opposite sides."""
    first = (np.abs(q[:, 0]) < 0.2 - thinner) & (q[:, 1] < 1.5 - thinner)
    second = (np.abs(q[:, 0] - 1) < 0.2 - thinner) & (q[:, 1] > -1.5 + thinner)
    return ~first & ~second


@pytest.mark.parametrize("seed", range(8))
def test_finds_the_way_through_two_gaps_and_shortens_it(seed):
    rng = np.random.default_rng(seed)
    start, goal = np.array([-1.0, 0, 0]), np.array([2.0, 0, 0])
    found = rrt_connect(start, goal, two_walls, LOWER, UPPER, rng)
    assert found is not None
    short = shortcut(found, two_walls, rng, rounds=20)
    for polyline in (found, short):
        np.testing.assert_array_equal(polyline[[0, -1]], [start, goal])
        # Between two tested points, 0.05 apart, a corner may be cut by half of that.
        assert two_walls(inner_points(polyline, 5000), 0.03).all()
        assert ((polyline >= LOWER) & (polyline <= UPPER)).all()
    lengths = [np.linalg.norm(np.diff(p, axis=0), axis=1).sum() for p in (found, short)]
    assert lengths[1] < lengths[0]


def test_the_same_seed_gives_the_same_path():
    start, goal = np.array([-1.0, 0, 0]), np.array([2.0, 0, 0])
    a, b = (rrt_connect(start, goal, two_walls, LOWER, UPPER, np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(a, b)


def test_gives_up_on_a_closed_wall():
    def closed(q):
        return np.abs(q[:, 0]) > 0.2

    ends = np.array([-1.0, 0, 0]), np.array([2.0, 0, 0])
    assert rrt_connect(*ends, closed, LOWER, UPPER, np.random.default_rng(0), max_rounds=10) is None


def test_a_free_line_needs_no_detour():
    def free(q):
        return np.ones(len(q), bool)

    start, goal = np.array([-1.0, 0, 0]), np.array([2.0, 0, 0])
    rng = np.random.default_rng(0)
    found = rrt_connect(start, goal, free, LOWER, UPPER, rng)
    np.testing.assert_array_equal(shortcut(found, free, rng), [start, goal])
