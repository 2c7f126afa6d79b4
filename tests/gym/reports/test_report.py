"""Reports of commands."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from regrasp_gym.reports.report import wilson, write_report


def test_a_report_says_what_it_was_made_with(tmp_path: Path) -> None:
    file = tmp_path / "results" / "report.json"
    write_report(file, {"share": np.float32(0.5), "name": "squares"}, packages=("numpy",))
    report = json.loads(file.read_text())
    assert report["share"] == 0.5
    assert report["versions"] == {"numpy": np.__version__}
    assert "cores" in report["machine"]
    write_report(None, {"anything": object()})


def test_what_json_does_not_know_becomes_null(tmp_path: Path) -> None:
    file = tmp_path / "report.json"
    write_report(file, {"median": float("nan"), "limits": [np.inf, 1.0], "name": Path("a")}, packages=())
    assert json.loads(file.read_text())["median"] is None
    assert json.loads(file.read_text())["limits"] == [None, 1.0]


@pytest.mark.parametrize(("count", "total"), [(0, 10), (3, 10), (10, 10), (120, 300)])
def test_the_interval_is_where_the_score_test_rejects(count: int, total: int) -> None:
    low, high = wilson(count, total)
    assert 0 <= low <= count / total <= high <= 1
    for share in {low, high} - {0.0, 1.0}:
        if 1e-9 < share < 1 - 1e-9:
            assert abs(count / total - share) == pytest.approx(1.959964 * np.sqrt(share * (1 - share) / total))
    assert wilson(0, 0) == (0.0, 1.0)
