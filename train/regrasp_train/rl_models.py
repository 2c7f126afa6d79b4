"""Models of Stable-Baselines3: made anew, with demonstrations, or restored from a checkpoint."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from regrasp_gym.reports.files import rewrite_lines
from regrasp_train.checkpoints import Clock
from regrasp_train.demonstrations import DemonstrationReplayBuffer, demonstration_buffer, read_demonstrations
from regrasp_train.goal_features import GoalFeatures, NormalizedReLU
from regrasp_train.learning_curve import read_points
from regrasp_train.rl_envs import make_learning_env
from regrasp_train.run_folder import BUFFER, CURVE_FILE, MODEL, PROGRESS, last_checkpoint

if TYPE_CHECKING:
    from regrasp_train.rl import TrainRlOptions

ALGORITHMS: dict[str, type[PPO | SAC]] = {"ppo": PPO, "sac": SAC}


def new_model(settings: dict[str, Any], envs: VecEnv, options: TrainRlOptions) -> tuple[BaseAlgorithm, Clock, float]:
    """An untrained model, with demonstrations if there are any; a new clock; −∞ as the best return so far."""
    clock = Clock()
    arguments = dict(settings["hyperparameters"])
    arguments["policy_kwargs"] = {
        "features_extractor_class": GoalFeatures,
        "features_extractor_kwargs": {"joints": settings["joints"]},
        **arguments.get("policy_kwargs", {}),
    }
    arguments |= {"seed": settings["seed"], "device": options.device, "tensorboard_log": str(options.run)}
    made = PPO(env=envs, **arguments) if settings["algo"] == "ppo" else new_sac(settings, envs, arguments)
    return made, clock, -np.inf


def new_sac(settings: dict[str, Any], envs: VecEnv, arguments: dict[str, Any]) -> BaseAlgorithm:
    """An untrained SAC model, with demonstrations in its replay buffer if there are any."""
    arguments["policy_kwargs"] = {"activation_fn": NormalizedReLU, **arguments["policy_kwargs"]}
    # Goals are relabelled with the end of an episode, so each environment must have finished one.
    first = settings["n_envs"] * (settings["episode_steps"] + 1)
    arguments["learning_starts"] = max(arguments.get("learning_starts", 0), first)
    buffer = {**arguments.pop("replay_buffer_kwargs", {}), "demo_share": settings["demo_share"]}
    model = SAC(env=envs, replay_buffer_class=DemonstrationReplayBuffer, replay_buffer_kwargs=buffer, **arguments)
    if settings["demos"] is not None:
        fill(model, settings, envs)
    return model


def fill(model: SAC, settings: dict[str, Any], envs: VecEnv) -> None:
    """Add demonstrations to a model's replay buffer."""
    env = make_learning_env(settings["env"], settings["env_kwargs"])
    try:
        episodes = read_demonstrations(Path(settings["demos"]), env)
    finally:
        env.close()
    assert isinstance(model.replay_buffer, DemonstrationReplayBuffer)
    model.replay_buffer.demos = demonstration_buffer(episodes, model.replay_buffer, envs)
    frames = sum(map(len, episodes))
    Console().print(f"{len(episodes)} demonstrations succeed again: {frames} transitions in the replay buffer")


def restored(settings: dict[str, Any], envs: VecEnv, options: TrainRlOptions) -> tuple[BaseAlgorithm, Clock, float]:
    """The model of the last checkpoint with its replay buffer, its clock, and the best return until then."""
    checkpoint = last_checkpoint(options.run)
    made = ALGORITHMS[settings["algo"]]
    model = made.load(checkpoint / MODEL, env=envs, device=options.device, tensorboard_log=str(options.run))
    if isinstance(model, SAC):
        # A run that is stopped leaves its last episode unfinished.
        warnings.filterwarnings("ignore", "(?s).*last trajectory in the replay buffer")
        model.load_replay_buffer(checkpoint / BUFFER)
        demos = getattr(model.replay_buffer, "demos", None)
        if demos is not None:
            demos.device = model.device
    progress = json.loads((checkpoint / PROGRESS).read_text())
    # The model's own seed would repeat the scenes and the noise from the start of the run.
    model.set_random_seed(settings["seed"] + progress["steps"])
    curve = options.run / CURVE_FILE
    if curve.exists():
        # Evaluations after the checkpoint are repeated.
        rewrite_lines(curve, read_points(curve, progress["steps"]))
    Console().print(f"Resuming at step {progress['steps']}", highlight=False)
    return model, Clock(progress["seconds"]), -np.inf if progress["best"] is None else progress["best"]
