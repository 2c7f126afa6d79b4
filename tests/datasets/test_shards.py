"""Episodes on disk, as LeRobot reads them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

pytest.importorskip("lerobot")

from scripted_experts import STEPS
from waves import SCENARIOS

from regrasp_datasets.features import DONE, SEED
from regrasp_datasets.films import EpisodeReader, replay_env
from regrasp_datasets.records import read_episodes

pytestmark = pytest.mark.lerobot


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
