"""The benchmark of releases."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from regrasp_bench.tables.releases import ReleasesOptions, releases, summarise
from regrasp_gym.errors import BenchError
from regrasp_gym.reports.files import read_lines


def test_the_command_writes_what_it_counted_and_resumes(tmp_path):
    files = {"records": tmp_path / "r.jsonl", "json_file": tmp_path / "r.json", "plot_file": tmp_path / "r.svg"}
    options = ReleasesOptions(trials=1, first_trial=1, **files)
    assert releases(options) == 0
    (record,) = read_lines(files["records"])
    assert set(record["drops"]) >= {"anywhere in the cone", "outside of the cone"}
    assert files["plot_file"].read_text().startswith("<?xml")
    report = json.loads(files["json_file"].read_text())
    assert report["groups"]["in the cone"]["releases"] == 1
    assert report["groups"]["planned"] == {**report["groups"]["planned"], "releases": 0, "share": None}
    before = files["records"].read_text()
    assert releases(options) == 0
    assert files["records"].read_text() == before
    with pytest.raises(BenchError, match="picture"):
        releases(replace(options, plot_file=tmp_path / "r.txt"))


@pytest.mark.slow
def test_planned_releases_are_tilted_and_settle(tmp_path):
    releases(ReleasesOptions(trials=12, records=tmp_path / "r.jsonl", json_file=tmp_path / "r.json"))
    drops = [record["drops"] for record in read_lines(tmp_path / "r.jsonl")]
    planned = [drop["planned"] for drop in drops if "planned" in drop]
    assert len(planned) == 6
    assert all(np.deg2rad(1) < drop["tilt"] <= drop["half_angle"] + 1e-9 for drop in planned)
    assert all(drop["settled"] for drop in planned)
    assert all(drop["… no finger in the way"]["settled"] for drop in drops if "… no finger in the way" in drop)


def test_the_summary_counts_by_group_and_kind():
    def drop(tilt, settled, stone):
        more = {"away_degrees": 0.0, "rested": True, "seconds": 1.0}
        return {"tilt": tilt, "half_angle": 0.4, "settled": settled, "stone": stone, **more}

    records = [
        {
            "trial": 0,
            "thing": "a",
            "half_angles": [0.4, 0.2],
            "without_cone": ["ball"],
            "drops": {"planned": drop(0.31, True, False), "outside of the cone": drop(0.71, False, False)},
        },
        {
            "trial": 1,
            "thing": "b",
            "half_angles": [0.2, 0.2],
            "without_cone": ["ball", "pin"],
            "drops": {"anywhere in the cone": drop(0.1, False, True), "paper's cone": drop(0.1, True, True)},
        },
        {"trial": 2, "crashed": "ValueError: no"},
    ]
    report = summarise({}, records)
    counts = {name: (row["settled"], row["releases"]) for name, row in report["groups"].items()}
    assert counts == {
        "in the cone": (1, 2),
        "planned": (1, 1),
        "planned, gripper retreating": (0, 0),
        "… no finger in the way": (0, 0),
        "anywhere in the cone": (0, 1),
        "outside of the cone": (0, 1),
        "paper's cone": (1, 1),
        "in the cone, shipped objects": (1, 1),
        "in the cone, stones": (0, 1),
    }
    assert [(row["multiple"], row["releases"]) for row in report["share_by_tilt"] if row["releases"]] == [
        (0.375, 1),
        (0.875, 1),
        (1.875, 1),
    ]
    assert [miss["trial"] for miss in report["misses"]] == [1]
    assert report["without_cone"] == {"ball": 2, "pin": 1}
    assert report["crashed"] == {"ValueError: no": [2]}
    assert report["half_angle_degrees"]["mean"] == pytest.approx(np.rad2deg(0.3))
