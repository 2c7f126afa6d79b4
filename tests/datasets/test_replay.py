"""Replaying recorded episodes."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("lerobot")

import pyarrow.parquet as pq
from waves import quiet

from regrasp_datasets.features import ACTION, STATE
from regrasp_datasets.records import DatasetError, read_episodes
from regrasp_datasets.replay import ReplayOptions, replay

pytestmark = pytest.mark.lerobot


def test_replay_is_exact(each_dataset, tmp_path):
    report = tmp_path / "replay.json"
    assert replay(ReplayOptions(each_dataset, json_file=report), quiet()) == 0
    summary = json.loads(report.read_text())
    assert summary["exact"] == len(read_episodes(each_dataset))
    assert all(episode["max_state_error"] == 0 for episode in summary["episodes"])


def test_replay_notices_a_changed_action(copied, tmp_path):
    path = next((copied / "data").rglob("*.parquet"))
    table = pq.read_table(path).to_pandas()
    action = table.at[5, ACTION].copy()
    action[0] += 1e-4
    table.at[5, ACTION] = action
    table.to_parquet(path)
    report = tmp_path / "replay.json"
    assert replay(ReplayOptions(copied, episodes=(0, 1), json_file=report), quiet()) == 1
    first, second = json.loads(report.read_text())["episodes"]
    assert first["first_difference"] == f"frame 6: {STATE}"
    assert 0 < first["max_state_error"] < 1e-2
    assert second["exact"]
    assert replay(ReplayOptions(copied, episodes=(0,), tolerance=1e-2), quiet()) == 0


def test_replay_of_an_unknown_episode(dataset):
    with pytest.raises(DatasetError, match="there is no episode 9"):
        replay(ReplayOptions(dataset, episodes=(9,)), quiet())
