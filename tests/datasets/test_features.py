"""Features have the numbers and names of the environment."""

from __future__ import annotations

import json

import numpy as np
import pytest

pytest.importorskip("lerobot")

import gymnasium as gym
from waves import SCENARIOS, WANTED_SEEDS

import regrasp_gym  # noqa: F401
from regrasp_datasets.features import ACTION, ENVIRONMENT_STATE, STATE
from regrasp_datasets.films import EpisodeReader

pytestmark = pytest.mark.lerobot


def test_features_have_the_env_s_numbers_and_names(robot, each_dataset):
    info = json.loads((each_dataset / "meta/info.json").read_text())
    features = info["features"]
    env = gym.make(SCENARIOS[robot][0], obs_type="pixels_agent_pos")
    obs, _ = env.reset(seed=WANTED_SEEDS[0])
    frames = EpisodeReader(each_dataset).read(0)
    np.testing.assert_array_equal(frames.state[0], obs["agent_pos"].astype(np.float32))
    np.testing.assert_array_equal(frames.environment_state[0], obs["environment_state"].astype(np.float32))
    env.close()
    assert features[STATE]["shape"] == list(obs["agent_pos"].shape)
    assert features[ENVIRONMENT_STATE]["names"][:7] == [
        f"target pose.{n}" for n in ("qw", "qx", "qy", "qz", "x", "y", "z")
    ]
    assert len(features[ENVIRONMENT_STATE]["names"]) == len(set(features[ENVIRONMENT_STATE]["names"]))
    assert features[ACTION]["names"] == features[STATE]["names"]
    assert info["robot_type"] == robot
