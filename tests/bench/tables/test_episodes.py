"""The benchmark of episodes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from regrasp_bench.tables.episodes import EpisodesOptions, episodes, summarise
from regrasp_gym.reports.files import read_lines


def test_episodes_are_counted_by_cause() -> None:
    common = {"planning_seconds": 0.5, "eval_grasp_calls": 40}
    held = {**common, "planned": True, "stages": ["pick-to-place"], "success": True, "cause": ""}
    found = [
        {"trial": 4, "seed": 4, **held},
        {"trial": 5, "seed": 5, **held, "stages": ["pick-to-release", "regrasp-to-place"]},
        {"trial": 6, "seed": 6, **held, "success": False, "cause": "lost grasp"},
        {"trial": 7, "seed": 7, **common, "planned": False, "stages": [], "success": False, "cause": "no path"},
        {"trial": 8, "crashed": "ValueError: no"},
    ]
    summary = summarise({"env": "some"}, found)
    assert (summary["episodes"], summary["planned"], summary["executed"]) == (5, 3, 2)
    assert (summary["planned_with_regrasp"], summary["seeds"]) == (1, [4, 8])
    assert summary["planning_failures"] == {"no path": 1}
    assert summary["execution_failures"] == {"lost grasp": 1}
    assert summary["failed_in_execution"] == [6]
    assert summary["crashed"] == {"ValueError: no": [8]}


@pytest.mark.slow
def test_the_benchmark_of_episodes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    records, json_file = tmp_path / "r.jsonl", tmp_path / "e.json"
    assert episodes(EpisodesOptions(strategy="direct", count=1, records=records)) == 0
    assert episodes(EpisodesOptions(strategy="direct", count=2, records=records, json_file=json_file)) == 0
    assert "1 of 2 are in" in " ".join(capsys.readouterr().out.split())
    found = read_lines(records)
    assert [record["trial"] for record in found] == [0, 1]
    report = json.loads(json_file.read_text())
    assert report["planned"] == sum(record["planned"] for record in found)
    assert report["executed"] == sum(record["success"] for record in found)
    assert report["versions"]["mujoco"]
