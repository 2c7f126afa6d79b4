"""What is kept beside the frames."""

from __future__ import annotations

import json

import numpy as np
import pytest

from regrasp_datasets.records import (
    ATTEMPTS_FILE,
    EPISODES_FILE,
    Attempt,
    DatasetError,
    read_attempts,
    require_dataset,
    state_sha256,
)
from regrasp_gym.reports.files import rewrite_lines


def test_digest_sees_every_bit():
    state = np.linspace(0.0, 1.0, 50)
    other = state.copy()
    other[17] = np.nextafter(other[17], 2.0)
    assert state_sha256(state) == state_sha256(state.copy())
    assert state_sha256(state) != state_sha256(other)
    assert state_sha256(np.array([0.0])) != state_sha256(np.array([-0.0]))


def test_digest_sees_type_shape_and_where_one_array_ends():
    ones = np.ones(4)
    assert state_sha256(ones) != state_sha256(ones.reshape(2, 2))
    assert state_sha256(np.zeros(2)) != state_sha256(np.zeros(2, dtype=np.int64))
    assert state_sha256(np.ones(1), np.ones(3)) != state_sha256(np.ones(2), np.ones(2))


def make_dataset(root):
    (root / "meta/episodes").mkdir(parents=True)
    (root / "data").mkdir()
    (root / "meta/info.json").write_text("{}")
    (root / EPISODES_FILE).write_text("")


def test_lines_survive_a_round_trip(tmp_path):
    make_dataset(tmp_path)
    attempts = [
        Attempt(3, "success", saved=True, target="004_sugar_box", stages=2, planning_seconds=0.25, frames=400),
        Attempt(4, "plan failed", reason='no grasp: "α"\nanother line'),
    ]
    rewrite_lines(tmp_path / ATTEMPTS_FILE, attempts)
    assert read_attempts(tmp_path) == attempts


@pytest.mark.parametrize("missing", ["meta/info.json", EPISODES_FILE, "data", "meta/episodes"])
def test_unfinished_folder_is_named(tmp_path, missing):
    make_dataset(tmp_path)
    require_dataset(tmp_path)
    path = tmp_path / missing
    path.rmdir() if path.is_dir() else path.unlink()
    with pytest.raises(DatasetError, match=missing):
        require_dataset(tmp_path)


def test_garbled_lines_are_named(tmp_path):
    make_dataset(tmp_path)
    (tmp_path / ATTEMPTS_FILE).write_text(json.dumps({"seed": 1, "outcome": "success"}) + "\n{half")
    with pytest.raises(DatasetError, match="regrasp_attempts"):
        read_attempts(tmp_path)
