"""Collecting, merging, reading back, replaying: the real environment, a scripted expert."""

from __future__ import annotations

import itertools
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

pytest.importorskip("lerobot")

import gymnasium as gym
import pyarrow.parquet as pq
from scripted_experts import STEPS

import regrasp_gym  # noqa: F401
from regrasp_datasets.collect import CollectError, CollectOptions, collect
from regrasp_datasets.features import ACTION, DONE, ENVIRONMENT_STATE, SEED, STAGE_INDEX, STATE
from regrasp_datasets.films import EpisodeReader, replay_env
from regrasp_datasets.records import EPISODES_FILE, DatasetError, read_attempts, read_episodes
from regrasp_datasets.replay import ReplayOptions, replay
from regrasp_datasets.rollout import RolloutError
from regrasp_datasets.verify import InvalidDatasetError, problems, require_valid, video_frames
from regrasp_datasets.workers import WorkerError
from regrasp_datasets.workspace import WorkspaceError

pytestmark = pytest.mark.lerobot

SCENARIOS = {
    "panda": ("regrasp_gym/PandaYCB-v0", 20, ("front", "wrist")),
    "excavator": ("regrasp_gym/ExcavatorStones-v0", 10, ("site", "cab")),
}
"""Environment, frames per second and cameras, by the robot's name."""
DIRECT_SEED = 3
"""One grasp is enough in this scene of either."""

# Seed 4 finds no plan, and seeds 3 and 6 hold no regrasp: one of them is wanted, and not more.
WANTED_SEEDS = [2, 3, 5, 7]


def options(root: Path, **changes) -> CollectOptions:
    common = {
        "root": root,
        "episodes": 4,
        "seed": 2,
        "workers": 2,
        "require_regrasp": 3,
        "image_size": 64,
        "keep_failures": True,
        "expert": "scripted_experts:WavingExpert",
    }
    return CollectOptions(**(common | changes))


def quiet() -> Console:
    return Console(quiet=True)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("collected") / "waves"
    assert collect(options(root, json_file=root.with_suffix(".json")), quiet()) == 0
    return root


@pytest.fixture(scope="module", params=SCENARIOS)
def robot(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def each_dataset(robot, request, tmp_path_factory) -> Path:
    """A dataset of each scenario in turn; but for the Panda's, as small as will do."""
    if robot == "panda":
        return request.getfixturevalue("dataset")
    root = tmp_path_factory.mktemp("collected") / robot
    changes = {"env": SCENARIOS[robot][0], "episodes": 2, "require_regrasp": 0, "workers": 1}
    assert collect(options(root, **changes), quiet()) == 0
    return root


@pytest.fixture
def copied(dataset, tmp_path) -> Path:
    return Path(shutil.copytree(dataset, tmp_path / "copied"))


def test_seeds_are_chosen_in_order_whatever_finishes_first(dataset):
    assert [record.seed for record in read_episodes(dataset)] == WANTED_SEEDS
    attempts = {attempt.seed: attempt for attempt in read_attempts(dataset)}
    assert list(attempts) == [2, 3, 4, 5, 6, 7]
    assert attempts[4].outcome == "plan failed"
    assert attempts[4].reason == "no grasp found"
    assert not (dataset.parent / "waves.collecting").exists()


def test_lerobot_reads_every_frame(robot, each_dataset):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    _, fps, cameras = SCENARIOS[robot]
    seeds = [record.seed for record in read_episodes(each_dataset)]
    data = LeRobotDataset("local/waves", root=each_dataset, video_backend="pyav")
    assert data.num_episodes == len(seeds)
    assert len(data) == STEPS * len(seeds)
    assert data.fps == fps
    for index in range(len(data)):
        item = data[index]
        for camera in cameras:
            assert item[f"observation.images.{camera}"].shape == (3, 64, 64)
        assert int(item[SEED]) == seeds[index // STEPS]
        assert bool(item[DONE]) == (index % STEPS == STEPS - 1)
        assert item["task"].strip()


def test_images_belong_to_their_frames(robot, each_dataset):
    """Each stored frame is nearest to the picture taken at that very step, not to a neighbour's."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    camera = {"panda": "wrist", "excavator": "site"}[robot]
    data = LeRobotDataset("local/waves", root=each_dataset, video_backend="pyav")
    record = read_episodes(each_dataset)[-1]
    frames = EpisodeReader(each_dataset).read(record.episode_index)
    env = replay_env(record, obs_type="pixels_agent_pos")
    obs, _ = env.reset(seed=record.seed)
    pictures = []
    for action in frames.action:
        pictures.append(obs["pixels"][camera].astype(float))
        obs, *_ = env.step(action)
    env.close()
    start = len(data) - STEPS
    # The codec leaves out what hardly changes, and 21 tonnes take a while to be seen moving.
    steps = [np.abs(after - before).mean() for before, after in itertools.pairwise(pictures)]
    moving = [index for index in range(STEPS) if min(steps[max(index - 1, 0) : index + 1]) > 0.5]
    assert len(moving) > STEPS // 2
    for index in moving:
        stored = 255 * data[start + index][f"observation.images.{camera}"].numpy().transpose(1, 2, 0)
        assert np.argmin([np.abs(stored - picture).mean() for picture in pictures]) == index


def test_features_have_the_env_s_numbers_and_names(robot, each_dataset):
    info = json.loads((each_dataset / "meta/info.json").read_text())
    features = info["features"]
    env = gym.make(SCENARIOS[robot][0], obs_type="pixels_agent_pos")
    obs, _ = env.reset(seed=WANTED_SEEDS[0])
    frames = EpisodeReader(each_dataset).read(0)
    np.testing.assert_array_equal(frames.state[0], obs["agent_pos"].astype(np.float32))
    np.testing.assert_array_equal(frames.environment_state[0], obs["environment_state"].astype(np.float32))
    env.close()
    assert features[STATE]["shape"] == list(obs["agent_pos"].shape)
    assert features[ENVIRONMENT_STATE]["names"][:7] == [
        f"target pose.{n}" for n in ("qw", "qx", "qy", "qz", "x", "y", "z")
    ]
    assert len(features[ENVIRONMENT_STATE]["names"]) == len(set(features[ENVIRONMENT_STATE]["names"]))
    assert features[ACTION]["names"] == features[STATE]["names"]
    assert info["robot_type"] == robot


def test_stage_index_follows_the_plan(dataset):
    table = pq.read_table(dataset / "data").to_pandas()
    for record, (_, episode) in zip(read_episodes(dataset), table.groupby("episode_index"), strict=True):
        assert record.stages == (1 if record.seed % 3 == 0 else 2)
        assert episode[STAGE_INDEX].max() == record.stages - 1
        assert episode[STAGE_INDEX].is_monotonic_increasing


def test_replay_is_exact(each_dataset, tmp_path):
    report = tmp_path / "replay.json"
    assert replay(ReplayOptions(each_dataset, json_file=report), quiet()) == 0
    summary = json.loads(report.read_text())
    assert summary["exact"] == len(read_episodes(each_dataset))
    assert all(episode["max_state_error"] == 0 for episode in summary["episodes"])


def test_replay_notices_a_changed_action(copied, tmp_path):
    path = next((copied / "data").rglob("*.parquet"))
    table = pq.read_table(path).to_pandas()
    action = table.at[5, ACTION].copy()
    action[0] += 1e-4
    table.at[5, ACTION] = action
    table.to_parquet(path)
    report = tmp_path / "replay.json"
    assert replay(ReplayOptions(copied, episodes=(0, 1), json_file=report), quiet()) == 1
    first, second = json.loads(report.read_text())["episodes"]
    assert first["first_difference"] == f"frame 6: {STATE}"
    assert 0 < first["max_state_error"] < 1e-2
    assert second["exact"]
    assert replay(ReplayOptions(copied, episodes=(0,), tolerance=1e-2), quiet()) == 0


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


def test_replay_films_an_episode(dataset, tmp_path):
    film = tmp_path / "film.mp4"
    assert replay(ReplayOptions(dataset, episodes=(1,), video=film), quiet()) == 0
    assert video_frames(film) == STEPS + 1


def test_replay_of_an_unknown_episode(dataset):
    with pytest.raises(DatasetError, match="there is no episode 9"):
        replay(ReplayOptions(dataset, episodes=(9,)), quiet())


def test_verify_counts_frames_in_the_videos(copied):
    import av

    assert problems(copied) == []
    path = next((copied / "videos/observation.images.front").rglob("*.mp4"))
    with av.open(str(path)) as source, av.open(str(path.with_name("short.mp4")), "w") as target:
        stream = target.add_stream("libsvtav1", rate=20)
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p"
        frames = list(source.decode(video=0))
        for frame in frames[:-2]:
            target.mux(stream.encode(frame))
        target.mux(stream.encode(None))
    path.with_name("short.mp4").replace(path)
    with pytest.raises(InvalidDatasetError, match=r"file-000.mp4 has 46 frames, its episodes have 48"):
        require_valid(copied)


@pytest.mark.parametrize(
    ("column", "row", "value", "words"),
    [
        (STATE, 3, np.nan, "not finite in frame 3"),
        (SEED, 3, 99, "other seeds than 2"),
        (DONE, 3, True, "not true on the last frame only"),
        ("timestamp", 3, 0.9, "time stamps"),
    ],
)
def test_verify_names_what_is_wrong(copied, column, row, value, words):
    path = next((copied / "data").rglob("*.parquet"))
    table = pq.read_table(path).to_pandas()
    if column == STATE:
        table.at[row, column] = np.full_like(table.at[row, column], value)
    else:
        table.at[row, column] = value
    table.to_parquet(path)
    (problem,) = problems(copied)
    assert problem.startswith("episode 0:")
    assert words in problem


def test_verify_finds_repeated_seeds(copied):
    lines = (copied / EPISODES_FILE).read_text().splitlines()
    lines[1] = json.dumps(json.loads(lines[1]) | {"seed": 2})
    (copied / EPISODES_FILE).write_text("\n".join(lines))
    assert any("[2]" in problem for problem in problems(copied))


def test_card_counts_what_is_there(dataset):
    card = (dataset / "README.md").read_text()
    assert card.startswith("---\nlicense: apache-2.0")
    assert "| episodes | 4 |" in card
    assert "| of them with a regrasp | 3 |" in card
    assert "| plan failed: no grasp found | 1 |" in card
    assert f"`{STATE}`" in card


def test_summary_matches_the_dataset(dataset):
    summary = json.loads(dataset.with_suffix(".json").read_text())
    assert [episode["seed"] for episode in summary["episodes"]] == WANTED_SEEDS
    assert summary["frames"] == STEPS * len(WANTED_SEEDS)
    assert summary["regrasps"] == 3


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


def test_environments_of_others_are_refused():
    from regrasp_datasets.rollout import make_env

    with pytest.raises(RolloutError, match="not an environment of regrasp_gym"):
        make_env("CartPole-v1", {})
