"""A scene, its collision model and configurations, for the tests of peers and benchmarks."""

from __future__ import annotations

from typing import Any

import gymnasium
import pytest

import regrasp_gym
from regrasp_planner.collision.model import CollisionModel
from regrasp_planner.stages.surroundings import MotionOptions, Surroundings


@pytest.fixture(scope="module")
def world() -> Any:
    """An environment with a scene on the table."""
    env = gymnasium.make("regrasp_gym/PandaYCB-v0")
    env.reset(seed=3)
    return regrasp_gym.PlannerExpert(env).env


@pytest.fixture(scope="module")
def surroundings(world: Any) -> Surroundings:
    """Makes collision models of the pick scene."""
    task = world.task()
    return Surroundings(world.planner_robot, task.target, task.pick.obstacles, MotionOptions())


@pytest.fixture(scope="module")
def empty_handed(world: Any, surroundings: Surroundings) -> CollisionModel:
    """Collision model of the pick scene with an empty gripper."""
    return surroundings.empty_handed(world.task().pick.target_pose)
