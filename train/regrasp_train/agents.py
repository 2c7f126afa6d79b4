"""Agents that can be evaluated: the expert, LeRobot policies and models of Stable-Baselines3."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import gymnasium as gym
import numpy as np

from regrasp_gym.reports.command_line import require_extra
from regrasp_train.errors import MismatchError, RunError

if TYPE_CHECKING:
    from lerobot.configs.policies import PreTrainedConfig

EXPERT = "expert"


class Agent(Protocol):
    """Chooses actions in the environment that it was made for."""

    def reset(self, seed: int) -> None:
        """Start an episode; called after the environment's reset."""
        ...

    def act(self, observation: dict[str, Any]) -> np.ndarray | None:
        """The next action, or None to give up."""
        ...

    @property
    def failure(self) -> str:
        """Why it gave up, in a few words; empty if it did not."""
        ...


def kind_of(policy: str) -> str:
    """Kind of a policy, given by name or path: "expert", "lerobot" or "sb3".

    Raises:
        RunError: it is no policy.
    """
    if policy == EXPERT:
        return EXPERT
    path = Path(policy)
    if path.is_file() and path.suffix == ".zip":
        return "sb3"
    if (path / "config.json").is_file():
        return "lerobot"
    for inner in ("pretrained_model", "checkpoints/last/pretrained_model"):
        if (path / inner / "config.json").is_file():
            raise RunError(f"{policy} holds a run or a checkpoint; give its policy: {path / inner}")
    raise RunError(
        f"{policy!r} is no policy: give 'expert', a folder with LeRobot's config.json (…/pretrained_model), or a model "
        ".zip of regrasp-train-rl"
    )


def trained_in(policy: str) -> tuple[str | None, dict[str, Any]]:
    """Id of the environment that a policy was trained in, if known, and arguments for ``gym.make``.

    Raises:
        RunError: the model belongs to no run of regrasp-train-rl.
    """
    kind = kind_of(policy)
    if kind == "sb3":
        from regrasp_train.run_folder import read_run

        run = read_run(Path(policy))
        return run["env"], {"control_mode": run["env_kwargs"].get("control_mode", "joint_pos")}
    if kind == "lerobot":
        saved = Path(policy) / "train_config.json"
        env = (json.loads(saved.read_text()).get("env") if saved.is_file() else None) or {}
        kwargs = {"control_mode": env.get("control_mode", "joint_pos")}
        if "image_size" in env:
            kwargs["image_size"] = (env["image_size"], env["image_size"])
        return (f"regrasp_gym/{env['task']}" if "task" in env else None), kwargs
    return None, {}


def obs_type_of(policy: str) -> str:
    """The ``obs_type`` that a policy needs."""
    if kind_of(policy) != "lerobot":
        return "state"
    inputs = json.loads((Path(policy) / "config.json").read_text()).get("input_features") or {}
    return "pixels_agent_pos" if any("images" in key for key in inputs) else "state"


def make_agent(policy: str, env: gym.Env, device: str | None = None) -> Agent:
    """Load a policy to act in ``env``.

    Raises:
        MissingExtraError: the packages for the policy are not installed.
        MismatchError: the environment's observations or actions differ from those of the training.
    """
    kind = kind_of(policy)
    if kind == EXPERT:
        return ExpertAgent(env)
    require_extra(f"evaluating {policy}", {"lerobot": "lerobot", "sb3": "rl"}[kind])
    return LeRobotAgent(Path(policy), env, device) if kind == "lerobot" else Sb3Agent(Path(policy), env, device)


class ExpertAgent:
    """The planner's expert."""

    def __init__(self, env: gym.Env) -> None:
        import regrasp_gym

        self._expert = regrasp_gym.PlannerExpert(env)

    def reset(self, seed: int) -> None:
        """Plan; the seed makes no difference."""
        del seed
        self._expert.reset()

    def act(self, observation: dict[str, Any]) -> np.ndarray | None:
        """The expert's action."""
        return self._expert.act(observation)

    @property
    def failure(self) -> str:
        """The expert's reason."""
        return "" if self._expert.failure is None else str(self._expert.failure.reason)


class LeRobotAgent:
    """A LeRobot policy.

    Args:
        path: folder of its config.json and weights.
        env: environment to act in.
        device: device of torch; by default that of the training, if available.
    """

    failure = ""

    def __init__(self, path: Path, env: gym.Env, device: str | None) -> None:
        import torch
        from lerobot.configs.policies import PreTrainedConfig
        from lerobot.policies.factory import get_policy_class, make_pre_post_processors

        config = PreTrainedConfig.from_pretrained(path)
        config.pretrained_path = path
        if device is not None:
            config.device = device
        self._env = env
        _check_features(path, config, env)
        self._policy = get_policy_class(config.type).from_pretrained(path, config=config)
        self._policy.eval()
        self._before, self._after = make_pre_post_processors(
            policy_cfg=config,
            pretrained_path=str(path),
            preprocessor_overrides={"device_processor": {"device": config.device}},
        )
        self._inputs = set(config.input_features or {})
        self._device = torch.device(config.device or "cpu")

    def reset(self, seed: int) -> None:
        """Start an episode and seed the sampling of actions."""
        import torch

        torch.manual_seed(seed)
        self._policy.reset()

    def act(self, observation: dict[str, Any]) -> np.ndarray:
        """The policy's action."""
        import torch
        from lerobot.policies.utils import prepare_observation_for_inference

        from regrasp_datasets.features import ENVIRONMENT_STATE, IMAGE_PREFIX, STATE, base_env, observe

        seen = observe(self._env, observation)
        parts = {STATE: seen.state, ENVIRONMENT_STATE: seen.environment_state}
        parts |= {IMAGE_PREFIX + camera: image for camera, image in seen.images.items()}
        wanted = {key: part for key, part in parts.items() if key in self._inputs}
        batch = prepare_observation_for_inference(wanted, self._device, base_env(self._env).task_description)
        with torch.inference_mode():
            action = self._after(self._policy.select_action(self._before(batch)))
        return action[0].cpu().numpy()


class Sb3Agent:
    """A model of Stable-Baselines3, acting without exploration.

    Args:
        path: its .zip, in the folder of its run.
        env: environment to act in.
        device: device of torch; by default the best available.
    """

    failure = ""

    def __init__(self, path: Path, env: gym.Env, device: str | None) -> None:
        from stable_baselines3 import PPO, SAC
        from stable_baselines3.common.buffers import DictReplayBuffer

        from regrasp_train.run_folder import read_run

        made = {"sac": SAC, "ppo": PPO}[read_run(path)["algo"]]
        # A replay buffer is of no use here: it would take memory, and one with hindsight needs an environment.
        unused = {"buffer_size": 1, "replay_buffer_class": DictReplayBuffer, "replay_buffer_kwargs": {}}
        model = made.load(path, device=device or "auto", custom_objects=unused)
        for name in ("observation_space", "action_space"):
            learnt, found = getattr(model, name), getattr(env, name)
            if _shapes(learnt) != _shapes(found):
                raise MismatchError(
                    f"{path} was trained with the {name.replace('_', ' ')} {_shapes(learnt)}, and "
                    f"{env.spec and env.spec.id} has {_shapes(found)}: evaluate it in {read_run(path)['env']}"
                )
        self._model = model

    def reset(self, seed: int) -> None:
        """Nothing is kept between steps."""

    def act(self, observation: dict[str, Any]) -> np.ndarray:
        """The most likely action."""
        action, _ = self._model.predict(
            {key: np.asarray(value, np.float32) for key, value in observation.items()}, deterministic=True
        )
        return action


def _check_features(path: Path, config: PreTrainedConfig, env: gym.Env) -> None:
    from regrasp_datasets.features import IMAGE_PREFIX, features_of

    features = features_of(env)
    for key, feature in {**(config.input_features or {}), **(config.output_features or {})}.items():
        shape = tuple(feature.shape)
        if key.startswith(IMAGE_PREFIX):
            shape = (*shape[1:], shape[0])
        found = tuple(features[key]["shape"]) if key in features else None
        if found != shape:
            raise MismatchError(
                f"{path} was trained with {key} of shape {shape}, and {env.spec and env.spec.id} has "
                f"{'none' if found is None else found}: evaluate it in the environment of its training"
            )


def _shapes(space: gym.Space) -> object:
    if isinstance(space, gym.spaces.Dict):
        return {key: part.shape for key, part in space.spaces.items()}
    return space.shape
