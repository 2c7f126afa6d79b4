"""RRT-Connect of OMPL."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from regrasp_bench.peers.coal_checker import ExactChecker
from regrasp_bench.peers.ompl_rrt import polyline, rrt_connect
from regrasp_bench.tables.path_queries import random_queries


@pytest.mark.slow
def test_rrt_connect_goes_round_what_is_in_the_way(world: Any) -> None:
    task, robot = world.task(), world.planner_robot
    queries = random_queries(task, robot, 2, np.random.default_rng(0))
    assert [kind for kind, _ in queries] == ["random"] * 2 + ["random, holding"] * 2
    for _, query in queries:
        checker = ExactChecker(query.space.model, query.space.theta)
        assert checker.free(np.stack([query.start, query.goal]))
        assert checker.collisions(polyline(np.stack([query.start, query.goal])))
        result = rrt_connect(checker, query.start, query.goal, time_limit=20.0)
        assert result.waypoints is not None
        assert result.waypoints[0] == pytest.approx(query.start)
        assert result.waypoints[-1] == pytest.approx(query.goal)
        assert len(result.waypoints) > 2
        assert result.checked > 50
        # Checked each degree: between two checks no more than a touch is possible.
        assert all(depth < 0.01 for *_, depth in checker.collisions(polyline(result.waypoints)))


def test_rrt_connect_gives_up_in_time(world: Any) -> None:
    _, query = random_queries(world.task(), world.planner_robot, 1, np.random.default_rng(0))[0]

    class Nowhere(ExactChecker):
        def free(self, q: np.ndarray) -> bool:
            return bool(np.minimum(np.abs(q - query.start).sum(1), np.abs(q - query.goal).sum(1)).max() < 1e-6)

    checker = Nowhere(query.space.model, query.space.theta)
    result = rrt_connect(checker, query.start, query.goal, time_limit=0.2)
    assert result.waypoints is None
    assert 0.1 < result.seconds < 5.0
