"""The benchmarks of modules and of whole episodes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from scenario_facts import Facts

from regrasp_bench.tables.episodes import episodes
from regrasp_bench.tables.episodes import summarise as summarise_episodes
from regrasp_bench.tables.modules import GRASP_GEN, SAMPLING, STAB_POSE, TRIMESH, modules, summarise
from regrasp_bench.tables.simulation import simulation
from regrasp_gym.reports.trials import read_records


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
    summary = summarise_episodes({"env": "some"}, found)
    assert (summary["episodes"], summary["planned"], summary["executed"]) == (5, 3, 2)
    assert (summary["planned_with_regrasp"], summary["seeds"]) == (1, [4, 8])
    assert summary["planning_failures"] == {"no path": 1}
    assert summary["execution_failures"] == {"lost grasp": 1}
    assert summary["failed_in_execution"] == [6]
    assert summary["crashed"] == {"ValueError: no": [8]}


def test_the_benchmark_of_the_simulation(facts: Facts, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    json_file = tmp_path / "s.json"
    simulation(facts.env_id, scenes=2, records=tmp_path / "s.jsonl", json_file=json_file)
    report = json.loads(json_file.read_text())
    assert (report["scenes"], report["crashed"]) == (2, {})
    seconds = {name: row["median"] for name, row in report["seconds"].items()}
    assert 0 < seconds["scene"] < seconds["reset, scene included"]
    assert 0 < seconds["observed picture, 128 × 128"] < seconds["frame, 640 × 480"]
    assert report["drift_max"] < 1e-3
    assert "step, random action" in capsys.readouterr().out


@pytest.mark.slow
def test_the_benchmark_of_modules(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    records, json_file, plot_file = tmp_path / "r.jsonl", tmp_path / "m.json", tmp_path / "m.svg"
    for _ in range(2):
        modules(
            scenes=1,
            repeats=1,
            strategies=("direct",),
            records=records,
            json_file=json_file,
            plot_file=plot_file,
        )
    shown = " ".join(capsys.readouterr().out.split())
    assert "1 of 1 are in" in shown
    assert "median ratio of times" in shown
    assert len(read_records(records)) == 1
    report = json.loads(json_file.read_text())
    assert report["crashed"] == {}
    assert {STAB_POSE, TRIMESH, GRASP_GEN, SAMPLING, "plan, direct"} <= set(report["modules"])
    assert all(row["seconds_median"] > 0 for row in report["modules"].values())
    assert report["modules"][SAMPLING]["eval_grasp_calls_mean"] in (0, 50_000)
    assert plot_file.stat().st_size > 5000


@pytest.mark.slow
def test_the_benchmark_of_episodes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    records, json_file = tmp_path / "r.jsonl", tmp_path / "e.json"
    episodes(strategy="direct", count=1, records=records)
    episodes(strategy="direct", count=2, records=records, json_file=json_file)
    assert "1 of 2 are in" in " ".join(capsys.readouterr().out.split())
    found = read_records(records)
    assert [record["trial"] for record in found] == [0, 1]
    report = json.loads(json_file.read_text())
    assert report["planned"] == sum(record["planned"] for record in found)
    assert report["executed"] == sum(record["success"] for record in found)
    assert report["versions"]["mujoco"]
