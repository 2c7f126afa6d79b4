"""Tables III and IV: rows, resuming, executions taken over from an earlier strategy."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from regrasp_bench.tables.paper import Table3Options, Table4Options, summarise, table3, table4
from regrasp_gym.errors import BenchError
from regrasp_gym.reports.files import read_lines

SEEDS = 2


def record(seed: int, *, planned: bool, success: bool = False, calls: int = 40, **more: Any) -> dict[str, Any]:
    stages = ["pick-to-place"] if planned else []
    return {
        "trial": seed,
        "planned": planned,
        "success": success,
        "stages": stages,
        "planning_seconds": 0.1 * (seed + 1),
        "eval_grasp_calls": calls,
        "ordered_starts": 10 * calls,
        "cause": "" if success else "lost grasp" if planned else "no common grasp",
        "taken_over_from": "",
        **more,
    }


def test_a_row_counts_what_was_planned_and_what_held() -> None:
    episodes = [
        record(0, planned=True, success=True),
        record(1, planned=True),
        record(2, planned=False, calls=100),
        {"trial": 3, "crashed": "ValueError: no"},
    ]
    row = summarise("panda", "static", episodes, execute=True)
    assert (row["trials"], row["planned"], row["executed"]) == (4, 2, 1)
    assert row["paper"] == {"planned": 170, "trials": 300}
    assert row["paper_eval_grasp_calls"] == 247
    assert row["eval_grasp_calls_mean"] == pytest.approx(60)
    assert row["ordered_starts_mean"] == pytest.approx(600)
    assert row["planning_seconds"]["median"] == pytest.approx(0.2)
    assert row["planning_failures"] == {"no common grasp": 1}
    assert row["execution_failures"] == {"lost grasp": 1}
    assert row["failed_in_execution"] == [1]
    assert row["crashed"] == {"ValueError: no": [3]}
    low, high = row["planned_share_95"]
    assert 0.15 < low < 0.5 < high < 0.85
    assert "executed" not in summarise("panda", "static", episodes, execute=False)


def test_a_scenario_without_environment_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(gymnasium.registry, "regrasp_gym/ExcavatorStones-v0", raising=False)
    with pytest.raises(BenchError, match="ExcavatorStones"):
        table3(Table3Options(scenario="excavator", trials=1, records=tmp_path / "records.jsonl"))


def test_a_bad_picture_is_refused_before_the_work(tmp_path: Path) -> None:
    file = tmp_path / "records.jsonl"
    with pytest.raises(BenchError, match=r"\.svg"):
        table3(Table3Options(trials=1, records=file, plot_file=tmp_path / "table.bmp"))
    assert not file.exists()


@pytest.mark.slow
def test_both_tables_of_two_scenes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    records, json_file, plot_file = tmp_path / "r.jsonl", tmp_path / "t3.json", tmp_path / "t3.svg"
    assert table3(Table3Options(trials=SEEDS, strategies=("direct",), records=records)) == 0
    assert len(read_lines(records)) == SEEDS
    files: dict[str, Path] = {"records": records, "json_file": json_file, "plot_file": plot_file}
    assert table3(Table3Options(trials=SEEDS, strategies=("static", "direct"), workers=2, **files)) == 0
    shown = capsys.readouterr().out
    assert "Table III" in shown
    assert f"direct: {SEEDS} of {SEEDS} are in" in shown.replace("\n", " ")
    found = read_lines(records)
    assert len(found) == 2 * SEEDS
    by = {(r["setting"]["strategy"], r["trial"]): r for r in found}
    for seed in range(SEEDS):
        direct, static = by["direct", seed], by["static", seed]
        # What one grasp can do is not done with more, and is not executed twice if it went as planned.
        if direct["planned"]:
            assert static["fingerprint"] == direct["fingerprint"]
            assert static["taken_over_from"] == ("direct" if direct["success"] and direct["plans"] == 1 else "")
            assert static["success"] == direct["success"]
        else:
            assert not static.get("taken_over_from")
    report = json.loads(json_file.read_text())
    rows = {row["strategy"]: row for row in report["strategies"]}
    assert list(rows) == ["direct", "static"]
    assert rows["static"]["planned"] == sum(by["static", seed]["planned"] for seed in range(SEEDS))
    assert rows["static"]["executed"] == sum(by["static", seed].get("success", False) for seed in range(SEEDS))
    assert report["versions"]["mujoco"]
    assert plot_file.stat().st_size > 5000

    # A lesser strategy's row is the same if it is read off a greater one's.
    other = tmp_path / "other.jsonl"
    table3(Table3Options(trials=SEEDS, strategies=("direct", "repeated"), execute=False, records=other))
    capsys.readouterr()
    for record in read_lines(other):
        if record["setting"]["strategy"] == "direct":
            alone = by["direct", record["trial"]]
            assert record["taken_over_from"] == "repeated"
            assert record["planned"] == alone["planned"]
            assert record["eval_grasp_calls"] == alone["eval_grasp_calls"]
            assert record["cause"] == (alone["cause"] if not alone["planned"] else "")

    json_file, plot_file = tmp_path / "t4.json", tmp_path / "t4.png"
    files = {"records": records, "json_file": json_file, "plot_file": plot_file}
    table4(Table4Options(trials=SEEDS, strategies=("direct", "static"), **files))
    assert "Table IV" in capsys.readouterr().out
    assert len(read_lines(records)) == 2 * SEEDS
    row = json.loads(json_file.read_text())["strategies"][0]
    assert row["eval_grasp_calls_mean"] == np.mean([by["direct", seed]["eval_grasp_calls"] for seed in range(SEEDS)])
    assert plot_file.stat().st_size > 5000
