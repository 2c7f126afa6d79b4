"""A scene, its collision model and configurations, for the tests of peers and benchmarks."""

from __future__ import annotations

from typing import Any

import gymnasium
import pytest

import regrasp_gym
from regrasp_planner.collision.model import CollisionModel
from regrasp_planner.stages.collision_models import CollisionModels
from regrasp_planner.stages.options import MotionOptions


@pytest.fixture(scope="module")
def world() -> Any:
    """An environment with a scene on the table."""
    env = gymnasium.make("regrasp_gym/PandaYCB-v0")
    env.reset(seed=3)
    return regrasp_gym.PlannerExpert(env).env


@pytest.fixture(scope="module")
def models(world: Any) -> CollisionModels:
    """Makes collision models of the pick scene."""
    task = world.task()
    return CollisionModels(world.planner_robot, task.target, task.pick.obstacles, MotionOptions())


@pytest.fixture(scope="module")
def empty_handed(world: Any, models: CollisionModels) -> CollisionModel:
    """Collision model of the pick scene with an empty gripper."""
    return models.empty_handed(world.task().pick.target_pose)
