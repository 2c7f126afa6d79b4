"""Our environments as LeRobot's commands make and use them, through its own functions and as a third party would."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("lerobot")

from lerobot.configs.parser import load_plugin
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env
from lerobot.envs.utils import NEW_ROLLOUT_OPTION, env_to_policy_features, preprocess_observation
from lerobot.utils.feature_utils import dataset_to_policy_features

from regrasp_datasets.features import features_of
from regrasp_datasets.rollout import make_env as make_one

pytestmark = pytest.mark.lerobot


@pytest.fixture(scope="module", autouse=True)
def registered():
    load_plugin("regrasp_datasets.lerobot_env")


def config(**changes):
    return EnvConfig.get_choice_class("regrasp")(image_size=64, **changes)


@pytest.mark.parametrize("use_async", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_batch_runs(use_async):
    envs = make_env(config(episode_length=3), n_envs=2, use_async_envs=use_async)
    vector = envs["regrasp"][0]
    try:
        raw, _ = vector.reset(seed=[3, 4], options={NEW_ROLLOUT_OPTION: True})
        observation = preprocess_observation(raw)
        assert observation["observation.images.front"].shape == (2, 3, 64, 64)
        assert observation["observation.state"].shape == (2, 8)
        assert list(vector.call("task_description")) == [scene.instruction for scene in vector.get_attr("scene")]
        for _ in range(3):
            raw, reward, _, truncated, info = vector.step(np.stack([vector.single_action_space.sample()] * 2))
        assert truncated.all()
        assert reward.shape == (2,)
        assert "is_success" in info["final_info"]
    finally:
        vector.close()


@pytest.mark.parametrize(
    ("obs_type", "images", "poses"),
    [
        ("pixels_agent_pos", True, False),
        ("environment_state_agent_pos", False, True),
        ("pixels_environment_state_agent_pos", True, True),
    ],
)
def test_policy_features_are_those_of_our_datasets(obs_type, images, poses):
    kwargs = {"obs_type": "pixels_agent_pos" if images else "state", "image_size": (64, 64)}
    of_dataset = dataset_to_policy_features(features_of(make_one("regrasp_gym/PandaYCB-v0", kwargs)))
    if not poses:
        of_dataset.pop("observation.environment_state")
    assert env_to_policy_features(config(obs_type=obs_type)) == of_dataset


def test_values_are_those_that_datasets_hold():
    vector = make_env(config(obs_type="environment_state_agent_pos"), n_envs=1)["regrasp"][0]
    raw, _ = vector.reset(seed=[5])
    alone = make_one("regrasp_gym/PandaYCB-v0", {"obs_type": "pixels_agent_pos"})
    obs, _ = alone.reset(seed=5)
    np.testing.assert_array_equal(raw["agent_pos"][0], obs["agent_pos"].astype(np.float32))
    np.testing.assert_array_equal(raw["environment_state"][0], obs["environment_state"].astype(np.float32))
    assert set(raw) == {"agent_pos", "environment_state"}
    vector.close()
    alone.close()


def test_unknown_observation_type_is_named():
    with pytest.raises(ValueError, match="obs_type='pixels' is unknown"):
        config(obs_type="pixels")
