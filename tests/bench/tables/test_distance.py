"""The benchmark of signed distances: its exact values, its errors and its report."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from regrasp_bench.tables.distance import (
    ALONE,
    CERTIFIED,
    COAL,
    DSF,
    GRADIENT,
    QUICK,
    THINNED,
    DistanceOptions,
    compare,
    distance,
    random_pairs,
    summarise,
)
from regrasp_gym.errors import BenchError


def test_random_pairs_are_hulls_of_that_many_vertices_and_overlap_half_the_time() -> None:
    pairs = random_pairs(200, 30)
    for hulls in (pairs.vertices_a, pairs.vertices_b):
        assert all(len(ConvexHull(points).vertices) == 30 for points in hulls[:20])
        assert 0.02 < np.ptp(hulls, axis=1).max() < 0.08
    again, other = random_pairs(200, 30), random_pairs(200, 30, seed=1)
    assert np.array_equal(pairs.poses_b, again.poses_b)
    assert not np.array_equal(pairs.poses_b, other.poses_b)


def test_exact_distances_are_those_of_the_difference_body() -> None:
    """A − B has the origin inside if they overlap, as deep as they do; else its distance from it is theirs."""
    pairs = random_pairs(24, 12)
    record = compare(pairs, rounds=1)
    exact = np.array(record["exact"])
    assert 3 <= (exact < 0).sum() <= 21
    for k in range(24):
        moved = []
        for points, pose in ((pairs.vertices_a[k], pairs.poses_a[k]), (pairs.vertices_b[k], pairs.poses_b[k])):
            moved.append(Rotation.from_quat(pose[:4], scalar_first=True).apply(points) + pose[4:])
        hull = ConvexHull((moved[0][:, None] - moved[1][None]).reshape(-1, 3))
        deepest = hull.equations[:, 3].max()
        if exact[k] < 0:
            assert exact[k] == pytest.approx(deepest, abs=1e-7)
        else:
            assert deepest <= exact[k] + 1e-9
    for name, worst in ((DSF, 5e-4), (CERTIFIED, 1e-4)):
        short = exact - np.asarray(record["found"][name])
        assert short.min() > -1e-9
        assert short[exact > 0].max() < worst
    assert np.median(np.array(record["angles"])[exact > 0]) < 1.0


@pytest.mark.slow
def test_a_run_reports_draws_and_resumes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = {"records": tmp_path / "d.jsonl", "json_file": tmp_path / "d.json", "plot_file": tmp_path / "d.svg"}
    assert distance(DistanceOptions(vertices=(12, 70), pairs=24, rounds=2, **files)) == 0
    report = json.loads(files["json_file"].read_text())
    assert report["crashed"] == {}
    assert list(report["vertices"]) == ["12", "70"]
    for vertices, row in report["vertices"].items():
        assert row["apart"]["pairs"] + row["overlapping"]["pairs"] == 24
        expected = {DSF, GRADIENT, QUICK, ALONE, COAL} | ({THINNED} if vertices == "70" else set())
        assert set(row["seconds_per_pair"]) == expected
        assert all(0 < row["seconds_per_pair_least"][k] <= row["seconds_per_pair"][k] for k in expected)
        for name in (DSF, CERTIFIED):
            assert row["apart"][name]["largest_excess"] < 1e-9
            assert 0 < row["apart"][name]["short_mean"] < 1e-3
    assert files["plot_file"].read_text().startswith("<?xml")
    assert "µs per pair" in capsys.readouterr().out

    lines = files["records"].read_text()
    assert distance(DistanceOptions(vertices=(70, 12), pairs=24, rounds=2, **files)) == 0
    assert files["records"].read_text() == lines
    assert list(json.loads(files["json_file"].read_text())["vertices"]) == ["70", "12"]


def test_summary_counts_errors_by_group_and_names_crashes() -> None:
    record = {
        "trial": 20,
        "exact": [1e-2, 2e-2, -1e-2],
        "found": {DSF: [9e-3, 2.1e-2, -1.5e-2]},
        "angles": [1.0, 3.0, 90.0],
        "seconds": {DSF: [3e-6, 1e-6, 2e-6]},
    }
    report = summarise({"pairs": 3, "rounds": 3}, [record, {"trial": 60, "crashed": "ValueError: no"}])
    row = report["vertices"]["20"]
    assert row["apart"]["pairs"] == 2
    assert row["apart"][DSF]["largest_excess"] == pytest.approx(1e-3)
    assert row["apart"][DSF]["short_max"] == pytest.approx(1e-3)
    assert row["overlapping"][DSF]["short_mean"] == pytest.approx(5e-3)
    assert row["overlapping"][DSF]["share_over_1_mm"] == 1.0
    assert row["normal_degrees"]["median"] == pytest.approx(2.0)
    assert row["seconds_per_pair"][DSF] == pytest.approx(2e-6)
    assert report["crashed"] == {"ValueError: no": [60]}


def test_a_picture_in_no_known_format_is_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"\.svg"):
        distance(DistanceOptions(plot_file=tmp_path / "d.jpeg", records=tmp_path / "d.jsonl"))
    assert not (tmp_path / "d.jsonl").exists()
