"""The benchmark of the simulation."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from scenario_facts import Facts

from regrasp_bench.tables.simulation import SimulationOptions, simulation


def test_the_benchmark_of_the_simulation(facts: Facts, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    json_file = tmp_path / "s.json"
    options = SimulationOptions(env=facts.env_id, scenes=2, records=tmp_path / "s.jsonl", json_file=json_file)
    assert simulation(options) == 0
    report = json.loads(json_file.read_text())
    assert (report["scenes"], report["crashed"]) == (2, {})
    seconds = {name: row["median"] for name, row in report["seconds"].items()}
    assert 0 < seconds["scene"] < seconds["reset, scene included"]
    assert 0 < seconds["observed picture, 128 × 128"] < seconds["frame, 640 × 480"]
    assert report["drift_max"] < 1e-3
    assert "step, random action" in capsys.readouterr().out
