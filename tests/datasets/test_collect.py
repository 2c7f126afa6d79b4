"""Collecting: which seeds are chosen, resumption, wrong options; the real environment, a scripted expert."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("lerobot")

import pyarrow.parquet as pq
from waves import SCENARIOS, WANTED_SEEDS, options, quiet

from regrasp_datasets.collect import CollectError, CollectOptions, collect
from regrasp_datasets.features import STAGE_INDEX
from regrasp_datasets.records import read_attempts, read_episodes
from regrasp_datasets.replay import ReplayOptions, replay
from regrasp_datasets.verify import video_frames
from regrasp_datasets.workers import WorkerError
from regrasp_datasets.workspace import WorkspaceError

pytestmark = pytest.mark.lerobot

DIRECT_SEED = 3
"""One grasp is enough in this scene of either robot."""


def test_seeds_are_chosen_in_order_whatever_finishes_first(dataset):
    assert [record.seed for record in read_episodes(dataset)] == WANTED_SEEDS
    attempts = {attempt.seed: attempt for attempt in read_attempts(dataset)}
    assert list(attempts) == [2, 3, 4, 5, 6, 7]
    assert attempts[4].outcome == "plan failed"
    assert attempts[4].reason == "no grasp found"
    assert not (dataset.parent / "waves.collecting").exists()


def test_stage_index_follows_the_plan(dataset):
    table = pq.read_table(dataset / "data").to_pandas()
    for record, (_, episode) in zip(read_episodes(dataset), table.groupby("episode_index"), strict=True):
        assert record.stages == (1 if record.seed % 3 == 0 else 2)
        assert episode[STAGE_INDEX].max() == record.stages - 1
        assert episode[STAGE_INDEX].is_monotonic_increasing


@pytest.mark.slow
def test_expert_s_demonstrations_replay(robot, tmp_path):
    """The planner itself, one episode from seed to picture, without a regrasp."""
    root, film, picture = tmp_path / "planned", tmp_path / "film.mp4", tmp_path / "plan.png"
    outputs = {"video": film, "plan_picture": picture}
    made = CollectOptions(
        root, SCENARIOS[robot][0], episodes=1, seed=DIRECT_SEED, max_attempts=4, image_size=64, **outputs
    )
    assert collect(made, quiet()) == 0
    (record,) = read_episodes(root)
    assert record.success
    assert record.planning_seconds > 0
    assert video_frames(film) == record.frames + 1
    assert picture.stat().st_size > 10_000
    assert replay(ReplayOptions(root), quiet()) == 0


def test_existing_folder_stays_as_it_is(dataset):
    before = sorted(path.stat().st_mtime_ns for path in dataset.rglob("*"))
    with pytest.raises(WorkspaceError, match="exists already"):
        collect(options(dataset), quiet())
    assert sorted(path.stat().st_mtime_ns for path in dataset.rglob("*")) == before


def test_resume_refuses_other_settings(dataset):
    with pytest.raises(WorkspaceError, match="strategy = 'repeated'"):
        collect(options(dataset, resume=True, strategy="direct"), quiet())
    assert not dataset.with_name("waves.collecting").exists()


def test_resume_adds_to_a_finished_dataset(copied):
    assert collect(options(copied, resume=True, episodes=6, workers=1), quiet()) == 0
    records = read_episodes(copied)
    assert [record.seed for record in records[:4]] == WANTED_SEEDS
    assert len({record.seed for record in records}) == 6
    assert replay(ReplayOptions(copied), quiet()) == 0


def test_only_successes_are_kept_unless_asked_otherwise(tmp_path):
    """The waving expert never succeeds: nothing is saved, and every seed has its reason."""
    root = tmp_path / "none"
    report = tmp_path / "none.json"
    changes = {"keep_failures": False, "images": False, "image_size": None, "max_attempts": 3, "workers": 1}
    assert collect(options(root, json_file=report, **changes), quiet()) == 1
    assert not root.exists()
    assert json.loads(report.read_text())["failures"] == {
        "execution failed: target not at its goal": 2,
        "plan failed: no grasp found": 1,
    }


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"episodes": 0}, CollectError, "at least 1"),
        ({"require_regrasp": 5}, CollectError, "between 0 and --episodes"),
        ({"image_size": 8}, CollectError, "between 64 and 1024"),
        ({"env": "regrasp_gym/Unknown-v0"}, WorkerError, "regrasp_gym/PandaYCB-v0"),
        ({"strategy": "clairvoyant"}, WorkerError, "Unknown strategy 'clairvoyant'; the strategies are direct"),
        ({"expert": "scripted_experts:Nobody"}, WorkerError, "Nobody"),
        ({"expert": "scripted_experts:CrashingExpert"}, CollectError, "division by zero"),
    ],
)
def test_wrong_options_give_one_message_and_leave_nothing(tmp_path, changes, error, words):
    root = tmp_path / "wrong"
    with pytest.raises(error, match=words):
        collect(options(root, workers=1, **changes), quiet())
    assert not root.exists()
    if error is not CollectError:
        assert list(tmp_path.iterdir()) == []
