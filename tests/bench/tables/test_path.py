"""The benchmark of paths."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from regrasp_bench.tables.path import PathOptions, path
from regrasp_gym.reports.files import read_lines


@pytest.mark.slow
def test_the_benchmark_of_two_scenes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    records, json_file, plot_file = tmp_path / "r.jsonl", tmp_path / "p.json", tmp_path / "p.svg"
    two = PathOptions(scenes=2, random_pairs=1, records=records, json_file=json_file, plot_file=plot_file)
    assert path(PathOptions(scenes=1, random_pairs=1, records=records)) == 0
    assert path(two) == 0
    shown = capsys.readouterr().out
    assert "1 of 2 are in" in shown.replace("\n", " ")
    assert "RRTConnect" in shown
    assert len(read_lines(records)) == 2
    report = json.loads(json_file.read_text())
    assert report["crashed"] == {}
    assert report["versions"]["ompl"]
    assert not [collision for collision in report["collisions"] if collision["planner"] == "ours"]
    kinds = report["kinds"]
    assert kinds["random"]["queries"] == 2
    assert kinds["planned"]["queries"] >= 1
    for figures in kinds.values():
        for name in ("ours", "rrt"):
            assert 0 <= figures[name]["free_of_collisions"] <= figures[name]["success"] <= figures["queries"]
    assert kinds["random"]["ours"]["seconds_median"] > 0
    assert report["lines"]["count"] >= 4
    assert report["lines"]["in_collision"] == []
    assert plot_file.stat().st_size > 5000
