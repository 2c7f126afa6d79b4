"""Environments for Stable-Baselines3, to learn and to evaluate in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv, VecMonitor

from regrasp_datasets.rollout import make_env
from regrasp_train.scenes import held_out


class Float32(gym.ObservationWrapper):
    """Observations in single precision, as networks take them; a replay buffer holds twice as many."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        space = env.observation_space
        assert isinstance(space, gym.spaces.Dict)
        self.observation_space = gym.spaces.Dict(
            {key: gym.spaces.Box(-np.inf, np.inf, part.shape, np.float32) for key, part in space.spaces.items()}
        )

    def observation(self, observation: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The observation in single precision."""
        return {key: np.asarray(value, np.float32) for key, value in observation.items()}

    @property
    def compute_reward(self) -> Callable[..., np.ndarray]:
        """Reward function of the environment, for relabelled goals."""
        return self.env.get_wrapper_attr("compute_reward")


class Seeds(gym.Wrapper):
    """Resets with the given seeds in turn, over and over."""

    def __init__(self, env: gym.Env, seeds: Sequence[int]) -> None:
        super().__init__(env)
        self._seeds, self._next = seeds, 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode with the next seed; ``seed`` is ignored."""
        del seed
        seed = self._seeds[self._next % len(self._seeds)]
        self._next += 1
        return self.env.reset(seed=seed, options=options)


def make_learning_env(env_id: str, env_kwargs: dict[str, Any]) -> gym.Env:
    """An environment to learn in: vectors only, and episodes continue after success."""
    return Float32(make_env(env_id, {**env_kwargs, "obs_type": "state"}))


def make_learning_envs(settings: dict[str, Any]) -> VecEnv:
    """The environments of a run to learn in. If there are several, each has a process of its own."""
    makers = [partial(make_learning_env, settings["env"], settings["env_kwargs"]) for _ in range(settings["n_envs"])]
    envs = DummyVecEnv(makers) if len(makers) == 1 else SubprocVecEnv(makers, start_method="spawn")
    return VecMonitor(envs, info_keywords=("is_success",))


def make_eval_env(env_id: str, env_kwargs: dict[str, Any], episodes: int) -> gym.Env:
    """An environment to evaluate in: the first validation seeds in turn, and episodes end on success."""
    first, kwargs = held_out(env_id, "val")
    kwargs = {**env_kwargs, **kwargs, "terminate_on_success": True}
    return Monitor(Seeds(make_learning_env(env_id, kwargs), range(first, first + episodes)))
