"""The benchmark of modules."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from regrasp_bench.tables.modules import GRASP_GEN, SAMPLING, STAB_POSE, TRIMESH, ModulesOptions, modules, summarise
from regrasp_gym.reports.files import read_lines


def test_modules_are_compared_scene_by_scene() -> None:
    def scene(trial: int, ours: float, peers: float, found: bool) -> dict:
        calls = {
            STAB_POSE: {"seconds": ours},
            TRIMESH: {"seconds": peers},
            GRASP_GEN: {"seconds": 0.1, "found": found, "evaluations": 40},
            SAMPLING: {"seconds": 2.0, "found": False, "evaluations": 50_000},
        }
        return {"trial": trial, "calls": calls}

    scenes = [scene(0, 1e-3, 6e-3, True), scene(1, 2e-3, 8e-3, False), scene(2, 1e-3, 5e-3, True)]
    report = summarise({"env": "some"}, [*scenes, {"trial": 3, "crashed": "ValueError: no"}])
    assert report["time_ratio_median"][f"{TRIMESH} / {STAB_POSE}"] == pytest.approx(5)
    assert report["time_ratio_median"][f"{SAMPLING} / {GRASP_GEN}"] == pytest.approx(20)
    grasp_gen = report["modules"][GRASP_GEN]
    assert (grasp_gen["calls"], grasp_gen["found"], grasp_gen["paper_seconds"]) == (3, 2, 0.18)
    assert report["modules"][STAB_POSE]["seconds_median"] == pytest.approx(1e-3)
    assert report["crashed"] == {"ValueError: no": [3]}


@pytest.mark.slow
def test_the_benchmark_of_modules(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    records, json_file, plot_file = tmp_path / "r.jsonl", tmp_path / "m.json", tmp_path / "m.svg"
    files: dict[str, Path] = {"records": records, "json_file": json_file, "plot_file": plot_file}
    for _ in range(2):
        assert modules(ModulesOptions(scenes=1, repeats=1, strategies=("direct",), **files)) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "1 of 1 are in" in shown
    assert "median ratio of times" in shown
    assert len(read_lines(records)) == 1
    report = json.loads(json_file.read_text())
    assert report["crashed"] == {}
    assert {STAB_POSE, TRIMESH, GRASP_GEN, SAMPLING, "plan, direct"} <= set(report["modules"])
    assert all(row["seconds_median"] > 0 for row in report["modules"].values())
    assert report["modules"][SAMPLING]["eval_grasp_calls_mean"] in (0, 50_000)
    assert plot_file.stat().st_size > 5000
