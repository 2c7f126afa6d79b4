"""The benchmark of stable poses."""

from __future__ import annotations

import json

import numpy as np

from regrasp_bench.tables.stable_poses import (
    POINTS,
    TIMED_POINTS,
    StablePosesOptions,
    is_stable,
    stable_poses,
    trial_object,
)
from regrasp_gym.objects import OBJECTS

BOX = OBJECTS["004_sugar_box"]


def test_standing_is_told_from_balancing():
    box = np.concatenate(BOX.pieces)
    directions = np.array([[0, 0, -1.0], [1, 0, 0], [1, 1, 0], [0.1, 0, -1]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_array_equal(is_stable(box, directions), [True, True, False, False])
    # With its centre of mass beyond the facet it topples.
    np.testing.assert_array_equal(is_stable(box - [-0.03, 0, 0], directions[:2]), [False, True])


def test_subjects_are_shipped_objects_then_random_hulls():
    assert trial_object(0, 10)[1] is OBJECTS[sorted(OBJECTS)[0]]
    kinds = [trial_object(trial, 10) for trial in range(len(OBJECTS), len(OBJECTS) + 20)]
    counts = [len(thing.pieces[0]) for _, thing in kinds]
    assert all(POINTS[0] <= count <= POINTS[1] for count in counts[:10])
    assert len(set(counts[:10])) > 5
    assert counts[10:] == [TIMED_POINTS] * 10
    assert len({kind for kind, _ in kinds}) == 2


def test_the_command_finds_all_and_invents_none(tmp_path):
    files = {"records": tmp_path / "s.jsonl", "json_file": tmp_path / "s.json", "plot_file": tmp_path / "s.png"}
    assert stable_poses(StablePosesOptions(hulls=2, drops=2, repeats=1, **files)) == 0
    report = json.loads(files["json_file"].read_text())
    row = report["kinds"]["all"]
    assert row["objects"] == len(OBJECTS) + 22
    assert row["invented"] == 0
    assert row["probability_found_least"] > 0.995
    assert row["drops"]["count"] == 2 * row["objects"]
    assert row["drops"]["into_a_pose_found"] > 0.97
    assert files["plot_file"].stat().st_size > 1000
    assert not report["crashed"]
