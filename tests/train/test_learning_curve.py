"""Learning curves survive being killed, and can be looked at."""

from __future__ import annotations

import pytest

from regrasp_gym.reports.files import append_line, rewrite_lines
from regrasp_train.learning_curve import (
    CurvePoint,
    curve_report,
    plot_curves,
    read_points,
)

POINTS = [CurvePoint(1000 * k, 60.0 * k, 20, 4 * k) for k in range(5)]


def test_points_survive_a_round_trip_and_a_half_written_line(tmp_path):
    file = tmp_path / "curve.jsonl"
    assert read_points(file) == []
    for point in POINTS:
        append_line(file, point)
    with file.open("a") as stream:
        stream.write('{"steps": 50')
    assert read_points(file) == POINTS


def test_what_came_after_the_last_checkpoint_is_dropped(tmp_path):
    file = tmp_path / "curve.jsonl"
    for point in POINTS:
        append_line(file, point)
    rewrite_lines(file, read_points(file, last_step=2500))
    assert read_points(file) == POINTS[:3]


def test_report_has_intervals():
    row = curve_report(POINTS)[2]
    low, high = row["success_rate_95"]
    assert row["success_rate"] == 0.4
    assert 0 < low < 0.4 < high < 1


def test_curves_are_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    picture = tmp_path / "plots" / "curve.png"
    plot_curves({"with demonstrations": POINTS, "without": POINTS[:2]}, picture, "Lift")
    assert picture.read_bytes()[:4] == b"\x89PNG"
