"""The benchmark of difficulty."""

from __future__ import annotations

import regrasp_gym  # noqa: F401
from regrasp_bench.tables.difficulty import compare, summarise


def record(trial, target, pick, goal, both):
    found = {"pick": pick, "goal": goal, "both": both, "common_grasps": 7 * both}
    return {"trial": trial, "target": target, **found}


def test_shares_and_comparison_count_what_they_say():
    judged = [record(0, "box", 2, 2, 2), record(1, "box", 2, 2, 1), record(2, "can", 2, 0, 0)]
    judged.append({"trial": 3, "crashed": "ValueError: no", "traceback": ""})
    report = summarise(judged)
    assert [report["shares"][name]["count"] for name in ("pick", "goal", "both")] == [3, 2, 1]
    assert report["shares_without_straight_lines"]["both"]["count"] == 2
    assert report["one_grasp_seeds"] == [0]
    assert report["targets"]["box"] == {"trials": 2, "pick": 2, "goal": 2, "both": 1}
    assert report["no_common_grasp"] == 1
    assert report["crashed"] == {"ValueError: no": [3]}
    planned = [{"trial": 0, "planned": False}, {"trial": 1, "planned": True}, {"trial": 3, "planned": True}]
    compared = compare(judged, planned)
    assert compared["missed_by_direct"] == [0]
    assert compared["missed_by_oracle"] == [1]
    assert compared["of_one_grasp_seeds"] == 0
