"""Queries of inverse kinematics."""

from __future__ import annotations

from typing import Any

import numpy as np

from regrasp_bench.tables.ik_queries import grasp_queries, random_queries


def test_queries_are_of_their_kind(world: Any) -> None:
    task, robot = world.task(), world.planner_robot
    queries = random_queries(task, robot, 2, np.random.default_rng(0))
    assert sorted(query.kind for query in queries) == ["random"] * 2 + ["random, close"] * 2
    grasps = grasp_queries(task, robot, 2)
    assert {query.kind for query in grasps} <= {"grasp at pick", "grasp at place"}
    for query in grasps:
        scene = task.pick if query.kind == "grasp at pick" else task.place
        assert np.linalg.norm(query.target[4:] - scene.target_pose[4:]) < 0.2
