"""Demonstrations for reinforcement learning: a LeRobot dataset as a permanent part of the replay buffer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from rich.progress import track
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from stable_baselines3.her.her_replay_buffer import HerReplayBuffer

from regrasp_train.errors import MismatchError

_Transition = tuple[dict[str, np.ndarray], dict[str, np.ndarray], np.ndarray, float, bool]


class DemonstrationReplayBuffer(HerReplayBuffer):
    """Hindsight experience replay that takes a share of every batch from demonstrations, if there are any.

    Args:
        *args: as for `HerReplayBuffer`.
        demo_share: share of each batch, 0 … 1 (Ball et al., "Efficient online reinforcement learning with offline
            data", ICML 2023, take half).
        **kwargs: as for `HerReplayBuffer`.
    """

    def __init__(self, *args: Any, demo_share: float = 0.5, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.demo_share = demo_share
        self.demos: HerReplayBuffer | None = None

    def set_env(self, env: VecEnv) -> None:
        """Use ``env`` to compute the rewards of relabelled goals."""
        super().set_env(env)
        if self.demos is not None:
            self.demos.set_env(env)

    def sample(self, batch_size: int, env: VecNormalize | None = None) -> DictReplayBufferSamples:  # type: ignore[override]
        """A batch. Until the first episode ends, all of it comes from demonstrations."""
        if self.demos is None:
            return super().sample(batch_size, env)
        count = round(self.demo_share * batch_size) if self.ep_length.any() else batch_size
        if count == 0:
            return super().sample(batch_size, env)
        theirs = self.demos.sample(count, env)
        if count == batch_size:
            return theirs
        return _joined(super().sample(batch_size - count, env), theirs)


def check_demonstrations(root: Path, env_id: str, control_mode: str) -> None:
    """Check that a dataset was recorded in an environment with a control mode.

    Raises:
        MismatchError: it was recorded in another.
        DatasetError: there is no finished dataset.
    """
    from regrasp_datasets.records import read_episodes

    for record in read_episodes(root):
        recorded = record.env_kwargs.get("control_mode", "joint_pos")
        if record.env_id != env_id or recorded != control_mode:
            raise MismatchError(
                f"{root} does not fit {env_id} with control_mode={control_mode!r}: its episode {record.episode_index} "
                f"is of {record.env_id} with {recorded!r}. Collect demonstrations with "
                f"regrasp-collect --env {env_id} --control-mode {control_mode} --no-images."
            )


def read_demonstrations(root: Path, env: gym.Env) -> list[list[_Transition]]:
    """Replay the episodes of a dataset as transitions of ``env``.

    So the observations are exact and have goals. Episodes that do not succeed again are left out.

    Args:
        root: folder of the dataset.
        env: environment to replay them in; see `check_demonstrations`.

    Returns:
        For each episode a list of (observation, next observation, action, reward, whether it is the last).

    Raises:
        MismatchError: no episode succeeds.
        DatasetError: there is no finished dataset.
    """
    from regrasp_datasets.films import EpisodeReader
    from regrasp_datasets.records import read_episodes

    records = read_episodes(root)
    reader = EpisodeReader(root)
    episodes: list[list[_Transition]] = []
    for record in track(records, "Replaying demonstrations", transient=True):
        episode = _replayed(env, record.seed, reader.read(record.episode_index).action)
        if episode:
            episodes.append(episode)
    if not episodes:
        raise MismatchError(f"none of the {len(records)} episodes of {root} succeeds again: regrasp-replay says why")
    return episodes


def demonstration_buffer(episodes: list[list[_Transition]], like: HerReplayBuffer, env: VecEnv) -> HerReplayBuffer:
    """A buffer of demonstrations that relabels goals as ``like`` does.

    Args:
        episodes: from `read_demonstrations`; actions are in the environment's units.
        like: buffer of the model.
        env: environment that computes the rewards of relabelled goals.
    """
    space = like.action_space
    assert isinstance(space, gym.spaces.Box)
    assert isinstance(like.observation_space, gym.spaces.Dict)
    buffer = HerReplayBuffer(
        sum(map(len, episodes)) + 1,
        like.observation_space,
        space,
        env,
        device=like.device,
        n_sampled_goal=like.n_sampled_goal,
        goal_selection_strategy=like.goal_selection_strategy,
    )
    for episode in episodes:
        for observation, following, action, reward, last in episode:
            # A replay buffer stores actions scaled to −1 … 1.
            scaled = 2 * (action - space.low) / (space.high - space.low) - 1
            # A demonstration's end does not end the task: the state after it has a value.
            info = {"TimeLimit.truncated": last}
            buffer.add(
                {key: value[None] for key, value in observation.items()},
                {key: value[None] for key, value in following.items()},
                scaled[None],
                np.array([reward]),
                np.array([last]),
                [info],
            )
    return buffer


def _replayed(env: gym.Env, seed: int, actions: np.ndarray) -> list[_Transition]:
    """Transitions of a replayed episode; none if it does not succeed."""
    observation, _ = env.reset(seed=seed)
    episode: list[_Transition] = []
    success = False
    for index, action in enumerate(actions):
        following, reward, _, truncated, info = env.step(action)
        last = index == len(actions) - 1 or truncated
        episode.append((observation, following, action, float(reward), last))
        success = bool(info["is_success"])
        if last:
            break
        observation = following
    return episode if success else []


def _joined(one: DictReplayBufferSamples, other: DictReplayBufferSamples) -> DictReplayBufferSamples:
    def both(a: dict[str, torch.Tensor], b: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        return {key: torch.cat([a[key], b[key]]) for key in a}

    return DictReplayBufferSamples(
        observations=both(one.observations, other.observations),
        actions=torch.cat([one.actions, other.actions]),
        next_observations=both(one.next_observations, other.next_observations),
        dones=torch.cat([one.dones, other.dones]),
        rewards=torch.cat([one.rewards, other.rewards]),
    )
