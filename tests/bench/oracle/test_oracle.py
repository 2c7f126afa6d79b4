"""Verdicts of the oracle."""

from __future__ import annotations

import numpy as np
import pytest

import regrasp_gym  # noqa: F401
from regrasp_bench.oracle.exhaustive_ik import ExhaustiveIkOptions
from regrasp_bench.oracle.oracle import GraspUse, Oracle, OracleOptions
from regrasp_planner import ConvexBody
from regrasp_planner.task import Body, Obstacle, Scene, Task


@pytest.fixture(scope="module")
def oracle(robot, coarse):
    return Oracle(robot, OracleOptions(grasps=coarse, ik=ExhaustiveIkOptions(bank=8000)))


def table_task(world, goal_x=0.5, goal_y=0.25, walls=()):
    """A cube on an empty table, to be moved elsewhere on it."""
    task = world.task()
    table = next(obstacle for obstacle in task.pick.obstacles if obstacle.body.name == "table")
    cube = Body("cube", (ConvexBody.box((0.05, 0.05, 0.05)),), np.zeros(3))
    start, goal = (np.array([1.0, 0, 0, 0, x, y, 0.025]) for x, y in ((0.5, -0.25), (goal_x, goal_y)))
    obstacles = (table, *walls)
    return Task(
        cube, Scene("pick", start, obstacles), Scene("place", goal, obstacles), task.release, task.start, task.supports
    )


def wall(name, size, position):
    return Obstacle(Body(name, (ConvexBody.box(size),), np.zeros(3)), np.array([1.0, 0, 0, 0, *position]))


def test_one_grasp_suffices_on_an_empty_table(world, oracle):
    verdict = oracle.judge(table_task(world))
    assert verdict[:3] == (GraspUse.MOVABLE, GraspUse.MOVABLE, GraspUse.MOVABLE)
    assert verdict.common_grasps > 0


def test_nothing_is_placed_beyond_reach(world, oracle):
    verdict = oracle.judge(table_task(world, goal_x=1.5))
    assert verdict[:3] == (GraspUse.MOVABLE, GraspUse.NONE, GraspUse.NONE)


def test_nothing_is_taken_out_of_a_well(world, oracle):
    beside = [wall(f"x{s}", (0.01, 0.2, 0.3), (0.5 + s * 0.045, -0.25, 0.15)) for s in (-1, 1)]
    beside += [wall(f"y{s}", (0.1, 0.01, 0.3), (0.5, -0.25 + s * 0.045, 0.15)) for s in (-1, 1)]
    verdict = oracle.judge(table_task(world, walls=beside))
    assert verdict.pick_grasps == 0
    assert verdict[:3] == (GraspUse.NONE, GraspUse.MOVABLE, GraspUse.NONE)


def test_walls_that_leave_different_sides_open_need_two_grasps(world, oracle):
    # Low roofs leave level grasps only, by the x faces at one end and by the y faces at the other.
    roofs = [wall(f"roof{y}", (0.3, 0.3, 0.02), (0.5, y, 0.09)) for y in (-0.25, 0.25)]
    ends = [wall(f"x{s}", (0.02, 0.12, 0.08), (0.5 + s * 0.06, -0.25, 0.04)) for s in (-1, 1)]
    sides = [wall(f"y{s}", (0.12, 0.02, 0.08), (0.5, 0.25 + s * 0.06, 0.04)) for s in (-1, 1)]
    verdict = oracle.judge(table_task(world, walls=(*roofs, *ends, *sides)))
    assert verdict.common_grasps == 0
    assert verdict.both is GraspUse.NONE


def test_the_same_task_gets_the_same_verdict(world, robot, oracle):
    world.reset(seed=3)
    again = Oracle(robot, oracle.options)
    assert oracle.judge(world.task()) == again.judge(world.task())
