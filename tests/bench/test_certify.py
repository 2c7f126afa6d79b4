"""Scenes by difficulty: the environments' lists, and the command that makes them."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest

import regrasp_gym  # noqa: F401  registers the environments
from regrasp_bench import certify
from regrasp_bench.certify import CRITERIA, CertifyOptions, kind_of, scenes_digest, setting_of
from regrasp_gym.errors import OptionError, SceneError
from regrasp_gym.scenes.table_shelf_config import TableShelfConfig
from regrasp_gym.seeds import FIRST_SEED, SPLITS, read_seeds, split_of

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
        ({"planned": True, "success": True, "stages": ["pick-to-place"], "plans": 1}, "panda_ycb_direct"),
        ({"planned": True, "success": True, "stages": ["pick-to-place"], "plans": 2}, None),
        ({"planned": True, "success": True, "stages": ["a", "b"], "plans": 2}, "panda_ycb_regrasp"),
        ({"planned": True, "success": False, "stages": ["a"], "plans": 1}, None),
        ({"planned": False, "success": False, "stages": []}, None),
        ({"crashed": "ValueError"}, None),
    ],
)
def test_only_executed_plans_certify(record, kind):
    assert kind_of(record) == kind


def test_scenes_judged_before_stay_listed(tmp_path, monkeypatch):
    """Every second scene takes one grasp, the others a regrasp; all but the first are judged in a second call."""
    judged = []

    def prepare(setting):
        def run(seed):
            judged.append(seed)
            return {"planned": True, "success": True, "plans": 1 + seed % 2, "stages": ["a"] * (1 + seed % 2)}

        return run

    monkeypatch.setattr(certify, "_prepare", prepare)
    places = {"records": tmp_path / "records.jsonl", "folder": tmp_path / "lists", "json_file": tmp_path / "n.json"}
    with pytest.raises(SceneError, match=r"panda_ycb_regrasp in the split 'val'.*--val"):
        certify.certify(CertifyOptions(train=4, val=1, test=2, **places))
    assert not places["folder"].exists()
    assert certify.certify(CertifyOptions(train=2, val=2, test=2, **places)) == 0
    assert len(judged) == len(set(judged)) == 8
    lists = [json.loads((places["folder"] / f"{name}.json").read_text()) for name in CRITERIA]
    assert [content["scenes"]["train"] for content in lists] == [[0, 2], [1, 3]]
    assert [content["scenes"]["val"] for content in lists] == [[FIRST_SEED["val"]], [FIRST_SEED["val"] + 1]]
    assert lists[0]["judged"] == {"train": 4, "val": 2, "test": 2}
    assert json.loads(places["json_file"].read_text())["listed"]["panda_ycb_direct"] == {
        "train": 2,
        "val": 1,
        "test": 1,
    }


def test_verdicts_of_another_effort_do_not_count(tmp_path, monkeypatch):
    monkeypatch.setattr(certify, "_prepare", lambda setting: lambda seed: {"planned": False})
    other = {"setting": {**setting_of(), "effort": "less"}, "planned": True, "success": True, "plans": 1}
    records = tmp_path / "records.jsonl"
    records.write_text("".join(json.dumps({**other, "trial": k, "stages": ["a"]}) + "\n" for k in range(3)))
    with pytest.raises(SceneError, match="'train'"):
        certify.certify(CertifyOptions(train=3, val=1, test=1, records=records, folder=tmp_path))


@pytest.mark.slow
def test_listed_scenes_are_what_the_lists_say():
    for env_id, name in IDS.items():
        env = gym.make(env_id, split="val")
        env.reset(seed=0)
        direct = env.unwrapped.plan("direct")
        assert direct.success == (name == "panda_ycb_direct")
        assert direct.success or env.unwrapped.plan("repeated").success
        env.close()


def test_scenes_are_those_of_the_list_alone():
    with pytest.raises(OptionError, match="scene_config"):
        gym.make("regrasp_gym/PandaYCBDirect-v0", scene_config=TableShelfConfig())
