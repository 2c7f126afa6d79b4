"""The benchmark of inverse kinematics."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from regrasp_bench.tables.ik import IkOptions, ik, summarise
from regrasp_gym.reports.files import read_lines


def test_a_wrong_answer_counts_as_missed() -> None:
    ours = {"found": True, "solved": False, "seconds": 0.1, "message": "", "seconds_in_batch": 0.02}
    mink = {"found": True, "solved": True, "seconds": 0.01, "starts": 3, "first_reached": False}
    queries = [
        {"kind": "random", "solvable": True, "ours": ours, "mink": mink},
        {"kind": "random", "solvable": True, "ours": ours | {"solved": True}, "mink": mink},
        {"kind": "grasp at pick", "solvable": False, "ours": ours, "mink": mink},
    ]
    figures = summarise({}, [{"trial": 7, "queries": queries}, {"trial": 8, "crashed": "ValueError: no"}])
    everything = figures["kinds"]["all"]
    assert (everything["poses"], everything["left_out"]) == (2, 1)
    assert (everything["ours"]["solved"], everything["ours"]["wrong"], everything["mink"]["solved"]) == (1, 1, 2)
    assert everything["missed"] == [(7, 0, "")]
    assert figures["crashed"] == {"ValueError: no": [8]}


@pytest.mark.slow
def test_the_benchmark_of_two_scenes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    records, json_file, plot_file = tmp_path / "r.jsonl", tmp_path / "ik.json", tmp_path / "ik.svg"
    one = IkOptions(scenes=1, random_poses=2, grasps=1, records=records)
    assert ik(one) == 0
    assert ik(replace(one, scenes=2, json_file=json_file, plot_file=plot_file)) == 0
    shown = capsys.readouterr().out
    assert "1 of 2 are in" in shown.replace("\n", " ")
    assert "mink" in shown
    assert len(read_lines(records)) == 2
    report = json.loads(json_file.read_text())
    assert report["crashed"] == {}
    assert report["versions"]["mink"]
    figures = report["kinds"]["all"]
    assert figures["poses"] >= 8
    assert figures["ours"]["solved"] == figures["poses"] - len(figures["missed"]) >= 7
    assert figures["ours"]["wrong"] == 0
    assert plot_file.stat().st_size > 5000
