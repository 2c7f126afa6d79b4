"""Registers the environments with LeRobot, for LeRobot's own commands.

``lerobot-eval --env.discover_packages_path=regrasp_datasets.lerobot_env --env.type=regrasp --env.task=PandaYCB-v0 …``
evaluates a policy; ``lerobot-train`` takes the same arguments. Observations have the keys, shapes and values of the
datasets that `regrasp_datasets.collect` writes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import freeze_after_episode_end

from regrasp_datasets.features import (
    ACTION,
    ENVIRONMENT_STATE,
    IMAGE_PREFIX,
    IMAGES_OBS_TYPE,
    STATE,
    VECTORS_OBS_TYPE,
    features_of,
    observe,
)
from regrasp_datasets.rollout import make_env

# LeRobot searches the module for submodules, so it must be a package: this one has none.
__path__: list[str] = []

OBS_TYPES = ("pixels_agent_pos", "environment_state_agent_pos", "pixels_environment_state_agent_pos")
"""What a policy sees: images and joints; joints and poses of objects; all three."""


class LeRobotObservation(gym.Wrapper):
    """An environment with LeRobot's observation keys in float32.

    Args:
        env: an environment of this project.
        obs_type: one of `OBS_TYPES`.
    """

    def __init__(self, env: gym.Env, obs_type: str) -> None:
        super().__init__(env)
        features = features_of(env)
        spaces: dict[str, gym.Space] = {"agent_pos": _box(features[STATE]["shape"])}
        if "environment_state" in obs_type:
            spaces["environment_state"] = _box(features[ENVIRONMENT_STATE]["shape"])
        if "pixels" in obs_type:
            spaces["pixels"] = gym.spaces.Dict(
                {
                    key.removeprefix(IMAGE_PREFIX): gym.spaces.Box(0, 255, feature["shape"], np.uint8)
                    for key, feature in features.items()
                    if key.startswith(IMAGE_PREFIX)
                }
            )
        self.observation_space = gym.spaces.Dict(spaces)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict[str, Any]]:
        """Start an episode. Options of LeRobot's, which mark its rollouts, are ignored."""
        known = {key: value for key, value in (options or {}).items() if not key.startswith("lerobot_")}
        obs, info = self.env.reset(seed=seed, options=known)
        return self._chosen(obs), info

    def step(self, action: np.ndarray) -> tuple[dict, float, bool, bool, dict[str, Any]]:
        """Act for one control period."""
        obs, reward, terminated, truncated, info = self.env.step(action)
        return self._chosen(obs), float(reward), terminated, truncated, info

    def _chosen(self, obs: dict[str, Any]) -> dict[str, Any]:
        seen = observe(self.env, obs)
        values = {"agent_pos": seen.state, "environment_state": seen.environment_state, "pixels": seen.images}
        assert isinstance(self.observation_space, gym.spaces.Dict)
        return {key: values[key] for key in self.observation_space.spaces}


@EnvConfig.register_subclass("regrasp")
@dataclass
class RegraspEnvConfig(EnvConfig):
    """Configuration of ``--env.type=regrasp``.

    Attributes:
        task: Gymnasium id without ``regrasp_gym/``.
        fps: control frequency, Hz.
        obs_type: one of `OBS_TYPES`.
        control_mode: ``joint_pos`` or ``ee_delta``.
        image_size: edge of the camera images, pixels.
        episode_length: time limit in steps; by default that of the environment.
        split: split of the listed scenes, in environments that have lists.
        terminate_on_success: end an episode once the task is solved.
    """

    task: str | None = "PandaYCB-v0"
    fps: int = 20
    obs_type: str = OBS_TYPES[0]
    control_mode: str = "joint_pos"
    image_size: int = 128
    episode_length: int | None = None
    split: str | None = None
    terminate_on_success: bool = True
    render_mode: str = "rgb_array"
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Read the shapes from the environment."""
        if self.obs_type not in OBS_TYPES:
            raise ValueError(f"obs_type={self.obs_type!r} is unknown; choose one of {', '.join(OBS_TYPES)}.")
        env = self._make()
        try:
            table = features_of(env)
        finally:
            env.close()
        self.features[ACTION] = PolicyFeature(type=FeatureType.ACTION, shape=table[ACTION]["shape"])
        self.features_map[ACTION] = ACTION
        self._add("agent_pos", STATE, FeatureType.STATE, table)
        if "environment_state" in self.obs_type:
            self._add("environment_state", ENVIRONMENT_STATE, FeatureType.ENV, table)
        for key in table:
            if key.startswith(IMAGE_PREFIX):
                self._add(f"pixels/{key.removeprefix(IMAGE_PREFIX)}", key, FeatureType.VISUAL, table)

    @property
    def package_name(self) -> str:
        """Package that registers the ids."""
        return "regrasp_gym"

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Keyword arguments of ``gym.make``."""
        images = "pixels" in self.obs_type
        chosen = {"max_episode_steps": self.episode_length, "split": self.split}
        return {
            "obs_type": IMAGES_OBS_TYPE if images else VECTORS_OBS_TYPE,
            "control_mode": self.control_mode,
            "image_size": (self.image_size, self.image_size),
            "render_mode": self.render_mode,
            "terminate_on_success": self.terminate_on_success,
            **{key: value for key, value in chosen.items() if value is not None},
        }

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, gym.vector.VectorEnv]]:
        """A vector of ``n_envs`` environments, as ``{type: {0: vector}}``."""
        # A finished episode waits for the others of its batch without being simulated.
        makers = [freeze_after_episode_end(self._make) for _ in range(n_envs)]
        mode = gym.vector.AutoresetMode.SAME_STEP
        if use_async_envs and n_envs > 1:
            vector = gym.vector.AsyncVectorEnv(makers, context="forkserver", autoreset_mode=mode)
        else:
            vector = gym.vector.SyncVectorEnv(makers, autoreset_mode=mode)
        return {self.type: {0: vector}}

    def _make(self) -> gym.Env:
        return LeRobotObservation(make_env(self.gym_id, self.gym_kwargs), self.obs_type)

    def _add(self, key: str, policy_key: str, kind: FeatureType, table: dict[str, dict[str, Any]]) -> None:
        self.features[key] = PolicyFeature(type=kind, shape=table[policy_key]["shape"])
        self.features_map[key] = policy_key


def _box(shape: tuple[int, ...]) -> gym.spaces.Box:
    return gym.spaces.Box(-np.inf, np.inf, shape, np.float32)
