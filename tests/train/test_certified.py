"""Scenes by difficulty: the environments' lists, and the command that makes them."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest

import regrasp_gym  # noqa: F401  registers the environments
from regrasp_gym.commands.certify import CRITERIA, kind_of, scenes_digest, write_list
from regrasp_gym.errors import OptionError, SceneError
from regrasp_gym.seeds import SPLITS, read_seeds, split_of

IDS = {"regrasp_gym/PandaYCBDirect-v0": "panda_ycb_direct", "regrasp_gym/PandaYCBRegrasp-v0": "panda_ycb_regrasp"}


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("split", SPLITS)
def test_seeds_are_numbers_in_the_list(env_id, split):
    listed = read_seeds(IDS[env_id])[split]
    env, plain = gym.make(env_id, split=split), gym.make("regrasp_gym/PandaYCB-v0")
    for seed in (0, len(listed) - 1, len(listed)):
        observation, info = env.reset(seed=seed)
        assert info["scene_seed"] == listed[seed % len(listed)]
        same, _ = plain.reset(seed=info["scene_seed"])
        for key in same:
            np.testing.assert_array_equal(observation[key], same[key])
    env.reset(seed=0)
    assert env.reset()[1]["scene_seed"] in listed
    # Scenes that are named are those of the plain environment.
    assert env.reset(options={"scene": 12345})[1]["scene_seed"] == 12345
    env.close()
    plain.close()


def test_no_scene_is_in_two_splits_or_two_lists():
    lists = [read_seeds(name) for name in IDS.values()]
    everything = [seed for splits in lists for seeds in splits.values() for seed in seeds]
    assert len(everything) == len(set(everything))
    assert all(split_of(seed) == split for splits in lists for split in SPLITS for seed in splits[split])


def test_shipped_lists_are_of_the_present_scenes():
    from importlib.resources import files

    for name in IDS.values():
        content = json.loads((files("regrasp_gym.seeds") / f"{name}.json").read_text())
        assert content["scenes_digest"] == scenes_digest(), "make the lists anew with regrasp-certify"


def test_unknown_split_is_named():
    with pytest.raises(OptionError, match="split='training'"):
        gym.make("regrasp_gym/PandaYCBDirect-v0", split="training")


def test_missing_list_is_named():
    with pytest.raises(SceneError, match=r"'no_such_list'.*regrasp-certify"):
        read_seeds("no_such_list")


@pytest.mark.parametrize(
    ("record", "kind"),
    [
        ({"planned": True, "success": True, "stages": ["pick-to-place"]}, "panda_ycb_direct"),
        ({"planned": True, "success": True, "stages": ["a", "b"]}, "panda_ycb_regrasp"),
        ({"planned": True, "success": False, "stages": ["a"]}, None),
        ({"planned": False, "success": False, "stages": []}, None),
        ({"crashed": "ValueError"}, None),
    ],
)
def test_only_executed_plans_certify(record, kind):
    assert kind_of(record) == kind


def test_a_longer_list_is_a_shorter_one_with_something_added(tmp_path):
    splits = []
    for stop in (50, 80):
        file = tmp_path / f"{stop}.json"
        write_list(file, next(iter(CRITERIA)), list(range(0, stop, 3)), range(stop))
        splits.append(json.loads(file.read_text())["scenes"])
    for split in SPLITS:
        assert splits[1][split][: len(splits[0][split])] == splits[0][split]
