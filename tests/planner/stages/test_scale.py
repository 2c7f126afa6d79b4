"""Robots of any size: the same task fifteen times as large is planned alike."""

from __future__ import annotations

from dataclasses import replace

import gymnasium
import numpy as np
import pytest

import regrasp_gym  # noqa: F401  registers the environments
from regrasp_planner import plan
from regrasp_planner.stages.scale import planner_scale, scaled_robot, scaled_task, to_planner_scale

SIZE = 15.0


@pytest.fixture(scope="module")
def small():
    env = gymnasium.make("regrasp_gym/PandaYCB-v0")
    env.reset(seed=2)
    yield env.unwrapped.task(), env.unwrapped.planner_robot
    env.close()


def test_a_hand_of_80_mm_is_left_alone(small):
    task, robot = small
    assert planner_scale(robot) == 1
    assert to_planner_scale(task, robot) == (task, robot)


def test_scaling_is_done_once_and_undone(small):
    task, robot = small
    large = scaled_robot(robot, SIZE)
    assert scaled_robot(robot, SIZE) is large
    assert large.unit * SIZE == pytest.approx(1)
    assert planner_scale(large) * SIZE == pytest.approx(1)
    back_task, back = to_planner_scale(scaled_task(task, SIZE), large)
    np.testing.assert_allclose(back.links.vertices, robot.links.vertices, atol=1e-12)
    np.testing.assert_allclose(back.gripper.screws, robot.gripper.screws, atol=1e-12)
    np.testing.assert_allclose(back_task.target.hull_vertices(), task.target.hull_vertices(), atol=1e-12)
    assert all(a is b for a, b in zip(back_task.pick.obstacles, back_task.place.obstacles, strict=True))


def test_a_large_robot_plans_like_a_small_one(small):
    task, robot = small
    one = plan(task, robot, "static")
    other = plan(scaled_task(task, SIZE), scaled_robot(robot, SIZE), "static")
    assert one.success
    assert other.success
    assert [stage.kind for stage in other.stages] == [stage.kind for stage in one.stages]
    for a, b in zip(one.stages, other.stages, strict=True):
        np.testing.assert_allclose(b.release_pose[4:], SIZE * a.release_pose[4:], atol=1e-4)
        np.testing.assert_allclose(b.grasp.pose[4:], SIZE * a.grasp.pose[4:], atol=1e-4)
        np.testing.assert_allclose(b.end, a.end, atol=1e-3)
        assert b.grasp.theta == pytest.approx(a.grasp.theta, abs=1e-6)


def test_messages_are_in_metres(small):
    task, robot = small
    large = replace(scaled_robot(robot, SIZE), unit=1.0)
    wide = scaled_task(task, 40 * SIZE)
    failed = plan(wide, large, "direct")
    assert failed.failure is not None
    assert "1200 mm" in failed.failure.message
