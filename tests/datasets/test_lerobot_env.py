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


@pytest.fixture(params=["PandaYCB-v0", "ExcavatorStones-v0"])
def task(request):
    return request.param


def config(**changes):
    return EnvConfig.get_choice_class("regrasp")(image_size=64, **changes)


def alone(task, **kwargs):
    """The environment without LeRobot."""
    return make_one(f"regrasp_gym/{task}", kwargs)


@pytest.mark.parametrize("use_async", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_batch_runs(task, use_async):
    one = alone(task).unwrapped
    envs = make_env(config(task=task, episode_length=3), n_envs=2, use_async_envs=use_async)
    vector = envs["regrasp"][0]
    try:
        raw, _ = vector.reset(seed=[3, 4], options={NEW_ROLLOUT_OPTION: True})
        observation = preprocess_observation(raw)
        for camera in one.scenario.pixels:
            assert observation[f"observation.images.{camera}"].shape == (2, 3, 64, 64)
        assert observation["observation.state"].shape == (2, *one.action_space.shape)
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
def test_policy_features_are_those_of_our_datasets(task, obs_type, images, poses):
    one = alone(task, obs_type="pixels_agent_pos" if images else "state", image_size=(64, 64))
    of_dataset = dataset_to_policy_features(features_of(one))
    if not poses:
        of_dataset.pop("observation.environment_state")
    assert env_to_policy_features(config(task=task, obs_type=obs_type)) == of_dataset


def test_values_are_those_that_datasets_hold(task):
    vector = make_env(config(task=task, obs_type="environment_state_agent_pos"), n_envs=1)["regrasp"][0]
    raw, _ = vector.reset(seed=[5])
    one = alone(task, obs_type="pixels_agent_pos")
    obs, _ = one.reset(seed=5)
    np.testing.assert_array_equal(raw["agent_pos"][0], obs["agent_pos"].astype(np.float32))
    np.testing.assert_array_equal(raw["environment_state"][0], obs["environment_state"].astype(np.float32))
    assert set(raw) == {"agent_pos", "environment_state"}
    vector.close()
    one.close()


def test_unknown_observation_type_is_named():
    with pytest.raises(ValueError, match="obs_type='pixels' is unknown"):
        config(obs_type="pixels")
