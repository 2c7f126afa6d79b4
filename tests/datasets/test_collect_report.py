"""The summary of a collection."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("lerobot")

from scripted_experts import STEPS
from waves import WANTED_SEEDS

pytestmark = pytest.mark.lerobot


def test_summary_matches_the_dataset(dataset):
    summary = json.loads(dataset.with_suffix(".json").read_text())
    assert [episode["seed"] for episode in summary["episodes"]] == WANTED_SEEDS
    assert summary["frames"] == STEPS * len(WANTED_SEEDS)
    assert summary["regrasps"] == 3
