"""Recorded episodes read back and shown: their numbers, a film, a picture of the plan."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from jaxtyping import UInt8

from regrasp_datasets.features import ACTION, ENVIRONMENT_STATE, REWARD, STATE, SUCCESS, VECTORS_OBS_TYPE, base_env
from regrasp_datasets.quiet import quiet_lerobot
from regrasp_datasets.records import EpisodeRecord, repo_id_of, require_dataset
from regrasp_datasets.rollout import RolloutError, RolloutOptions, make_env, make_expert
from regrasp_gym.rendering.film import write_film


@dataclass(frozen=True)
class EpisodeFrames:
    """The recorded numbers of one episode of T frames.

    Attributes:
        state: (T, n) float32.
        environment_state: (T, m) float32.
        action: (T, a) float32.
        reward: (T,) float32.
        success: (T,) bool.
    """

    state: np.ndarray
    environment_state: np.ndarray
    action: np.ndarray
    reward: np.ndarray
    success: np.ndarray


class EpisodeReader:
    """Reads the numbers of a dataset's episodes, without decoding any video.

    Args:
        root: folder of a finished dataset.

    Raises:
        DatasetError: there is none.
    """

    def __init__(self, root: Path) -> None:
        require_dataset(root)
        quiet_lerobot()
        from lerobot.datasets.lerobot_dataset import LeRobotDataset

        self._dataset = LeRobotDataset(repo_id_of(root), root=root, video_backend="pyav")
        columns = [STATE, ENVIRONMENT_STATE, ACTION, REWARD, SUCCESS]
        self._frames = self._dataset.hf_dataset.select_columns(columns).with_format("numpy")

    def __len__(self) -> int:
        return self._dataset.num_episodes

    def read(self, episode_index: int) -> EpisodeFrames:
        """The numbers of one episode."""
        episodes = self._dataset.meta.episodes
        assert episodes is not None
        episode = episodes[episode_index]
        rows = self._frames[episode["dataset_from_index"] : episode["dataset_to_index"]]
        return EpisodeFrames(
            state=np.asarray(rows[STATE], dtype=np.float32),
            environment_state=np.asarray(rows[ENVIRONMENT_STATE], dtype=np.float32),
            action=np.asarray(rows[ACTION], dtype=np.float32),
            reward=np.asarray(rows[REWARD], dtype=np.float32),
            success=np.asarray(rows[SUCCESS], dtype=bool),
        )


def replay_env(record: EpisodeRecord, **changes: Any) -> gym.Env:
    """Make the environment of a recorded episode, without camera observations, which do not affect the physics.

    Args:
        record: record of the episode.
        **changes: further keyword arguments for ``gym.make``.
    """
    return make_env(record.env_id, record.env_kwargs | {"obs_type": VECTORS_OBS_TYPE} | changes)


def film_episode(root: Path, record: EpisodeRecord, path: Path) -> None:
    """Film an episode, as the overview camera sees it, by running it again.

    Args:
        root: folder of the dataset.
        record: record of the episode.
        path: MP4 file to write; its folder is made.
    """
    frames = EpisodeReader(root).read(record.episode_index)
    env = replay_env(record, render_mode="rgb_array")

    def pictures() -> Iterator[UInt8[np.ndarray, "H W 3"]]:
        env.reset(seed=record.seed)
        yield _picture(env)
        for action in frames.action:
            env.step(action)
            yield _picture(env)

    try:
        write_film(path, pictures(), env.metadata["render_fps"])
    finally:
        env.close()


def picture_plan(record: EpisodeRecord, path: Path, stored: Path) -> None:
    """Draw the plan of an episode.

    Args:
        record: record of the episode.
        path: PNG file to write; its folder is made.
        stored: pickle of the plan. It must come from this collection, as unpickling runs code. If there is no such
            file, the scene is planned again: slower, with the same plan.

    Raises:
        RolloutError: the expert finds no plan, although it found one when the episode was recorded.
    """
    from regrasp_gym.expert.plan_picture import save_plan_picture

    env = replay_env(record, render_mode="rgb_array")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        env.reset(seed=record.seed)
        if stored.exists():
            plan = pickle.loads(stored.read_bytes())
        else:
            options = RolloutOptions(record.env_id, record.env_kwargs, record.expert, record.strategy)
            expert = make_expert(options, env)
            plan = expert.plan if expert.reset() else None
            if plan is None:
                raise RolloutError(f"The expert finds no plan for seed {record.seed} any more: {expert.failure}")
        save_plan_picture(base_env(env), plan, path)
    finally:
        env.close()


def _picture(env: gym.Env) -> np.ndarray:
    picture = env.render()
    if not isinstance(picture, np.ndarray):
        raise RolloutError(f"render() gave a {type(picture).__name__}, not a picture.")
    return picture
