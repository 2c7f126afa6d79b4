"""Films of recorded episodes."""

from __future__ import annotations

import pytest

pytest.importorskip("lerobot")

from scripted_experts import STEPS
from waves import quiet

from regrasp_datasets.replay import ReplayOptions, replay
from regrasp_datasets.verify import video_frames

pytestmark = pytest.mark.lerobot


def test_replay_films_an_episode(dataset, tmp_path):
    film = tmp_path / "film.mp4"
    assert replay(ReplayOptions(dataset, episodes=(1,), video=film), quiet()) == 0
    assert video_frames(film) == STEPS + 1
