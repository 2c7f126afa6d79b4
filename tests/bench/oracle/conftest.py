"""A scene on the table, its robot, and a coarse grid of grasps."""

from __future__ import annotations

import gymnasium
import pytest

import regrasp_gym  # noqa: F401
from regrasp_bench.oracle.antipodal import AntipodalOptions


@pytest.fixture(scope="module")
def world():
    env = gymnasium.make("regrasp_gym/PandaYCB-v0").unwrapped
    env.reset(seed=0)
    return env


@pytest.fixture(scope="module")
def robot(world):
    return world.planner_robot


@pytest.fixture(scope="session")
def coarse():
    return AntipodalOptions(rays=300, cloud=3000, angles=12, across=0.03, depths=3)
