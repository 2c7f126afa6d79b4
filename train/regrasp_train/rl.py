"""``regrasp-train-rl``: reinforcement learning with Stable-Baselines3."""

from __future__ import annotations

import json
import sys
import warnings
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import tyro
from rich.console import Console

from regrasp_datasets.quiet import quiet_environment
from regrasp_gym.reports.command_line import JsonFile, require_extra, run_command
from regrasp_gym.reports.files import rewrite_lines
from regrasp_train.configs import read_config
from regrasp_train.errors import RunError
from regrasp_train.run_folder import (
    BUFFER,
    CURVE_FILE,
    MODEL,
    PROGRESS,
    check_new,
    checkpoints_in,
    last_checkpoint,
    lock_run,
    read_run,
    write_run,
)
from regrasp_train.threads import threads

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecEnv

    from regrasp_train.checkpoints import Clock

OUR_KEYS = ("n_envs", "n_timesteps", "env_kwargs", "demo_share")
"""Hyper-parameters that are not Stable-Baselines3's."""


@dataclass(frozen=True)
class TrainRlOptions:
    """Train a policy by reinforcement learning with Stable-Baselines3: SAC with hindsight experience replay, or PPO.

    Success on validation scenes is measured as it learns, and makes the learning curve. Checkpoints, replay buffer
    included, let a run that was killed go on with --resume. The last model is RUN/model.zip, the best one on the
    validation scenes RUN/best/best_model.zip; regrasp-eval takes either.
    """

    run: Path
    """Folder of the run; it must not exist, unless --resume is given."""
    env: str = "regrasp_gym/PandaYCBLift-v0"
    """Gymnasium id of the environment."""
    algo: Literal["sac", "ppo"] = "sac"
    """The algorithm."""
    config: str | None = None
    """YAML file of hyper-parameters by environment; by default the shipped one of the algorithm."""
    demos: Path | None = None
    """Dataset of demonstrations, collected in this environment with the config's control mode (SAC only)."""
    steps: int | None = None
    """Environment steps, instead of the config's."""
    minutes: float | None = None
    """Stop after this time, that of a resumed run before included."""
    envs: int | None = None
    """Environments side by side, instead of the config's."""
    save_every: int | None = None
    """Steps between checkpoints; 20,000 by default."""
    eval_every: int | None = None
    """Steps between evaluations; 10,000 by default."""
    eval_episodes: int | None = None
    """Episodes of each evaluation, on validation scenes; 20 by default."""
    seed: int = 0
    """Of weights, exploration and scenes."""
    device: str = "auto"
    """cpu, cuda or mps; what is there by default."""
    resume: bool = False
    """Go on from the last checkpoint of the run. What it learns and how stays as it was; --steps, --minutes,
    --save-every, --eval-every and --eval-episodes can be changed."""
    progress: bool = True
    """Whether to show a progress bar."""
    json_file: JsonFile = None
    """File for the learning curve as JSON."""
    plot: Path | None = None
    """Picture of the learning curve."""
    compare: tuple[Path, ...] = ()
    """Folders of other runs whose curves go into the same picture and JSON."""


def main() -> int:
    """Entry point of ``regrasp-train-rl``: 0 if done, 2 for wrong use, 130 for Ctrl-C."""
    command = tyro.cli(TrainRlOptions, prog="regrasp-train-rl", description=TrainRlOptions.__doc__)
    quiet_environment()
    return run_command("regrasp-train-rl", lambda: train(command), resume=f"go on with --run {command.run} --resume")


def train(command: TrainRlOptions) -> int:
    """Do what ``command`` says; 0.

    Raises:
        MissingExtraError: Stable-Baselines3, or what reads demonstrations, is not installed.
        RunError: the folder of the run, of one to compare with, or the config, cannot be used.
        MismatchError: the demonstrations are of another environment.
        RolloutError: the environment cannot be made.
        BenchError: the picture's name does not say of what kind it is.
    """
    require_extra("regrasp-train-rl", "rl")
    if command.demos is not None:
        require_extra("regrasp-train-rl --demos", "lerobot")
    check_report(command)
    settings = resumed_settings(command) if command.resume else new_settings(command)
    import torch
    from stable_baselines3.common.callbacks import CallbackList, EvalCallback
    from stable_baselines3.common.vec_env import DummyVecEnv

    from regrasp_train.checkpoints import Checkpoints, CurvePoints
    from regrasp_train.rl_envs import make_eval_env

    torch.set_num_threads(threads())
    with lock_run(command.run):
        write_run(command.run, settings)
        envs = learning_envs(settings)
        # A single environment is quickest to judge in, however many there are to learn in.
        warnings.filterwarnings("ignore", "Training and eval env are not of the same type")
        episodes = settings["eval_episodes"]
        judging = DummyVecEnv([partial(make_eval_env, settings["env"], settings["env_kwargs"], episodes)])
        try:
            model, clock, best = (restored if command.resume else new_model)(settings, envs, command)
            evaluation = EvalCallback(
                judging,
                callback_after_eval=CurvePoints(command.run / CURVE_FILE, clock),
                n_eval_episodes=episodes,
                eval_freq=max(settings["eval_every"] // envs.num_envs, 1),
                log_path=str(command.run / "evaluations"),  # successes are counted only with one
                best_model_save_path=str(command.run / "best"),
                verbose=0,
            )
            evaluation.best_mean_reward = best
            budget = None if settings["minutes"] is None else 60 * settings["minutes"]
            checkpoints = Checkpoints(command.run, settings["save_every"], clock, evaluation, budget)
            total = settings["n_timesteps"]
            told = f"{settings['algo'].upper()} in {settings['env']}, {total} steps; tensorboard --logdir {command.run}"
            Console().print(told, highlight=False, soft_wrap=True)
            if model.num_timesteps >= total:
                Console().print(f"It has learnt from {model.num_timesteps} steps already: give more with --steps")
            else:
                model.learn(
                    total - model.num_timesteps,
                    callback=CallbackList([evaluation, checkpoints]),
                    reset_num_timesteps=False,
                    tb_log_name="tensorboard",
                    progress_bar=command.progress,
                )
            model.save(command.run / "model.zip")
        finally:
            envs.close()
            judging.close()
    report(command, clock)
    return 0


def new_settings(command: TrainRlOptions) -> dict[str, Any]:
    """Settings of a new run, once it is sure that it can begin."""
    from regrasp_datasets.features import base_env
    from regrasp_datasets.rollout import make_env

    check_new(command.run, resumable=bool(checkpoints_in(command.run)))
    if command.demos is not None and command.algo != "sac":
        raise RunError(f"--demos needs a replay buffer, which --algo {command.algo} has not: use --algo sac")
    by_env = read_config(command.config or command.algo)
    config = by_env.get(command.env, by_env.get("default"))
    if config is None:
        name = command.config or command.algo
        raise RunError(f"config {name!r} has no table {command.env!r} and no table 'default', as shipped sac.yml has")
    env_kwargs = config.get("env_kwargs", {})
    env = make_env(command.env, {**env_kwargs, "obs_type": "state"})
    joints = len(base_env(env).scenario.robot.arm_joints)
    env.close()
    assert env.spec is not None, "an environment made by its id has a specification"
    if command.demos is not None:
        from regrasp_train.demonstrations import check_demonstrations

        check_demonstrations(command.demos, command.env, env_kwargs.get("control_mode", "joint_pos"))
    return {
        "algo": command.algo,
        "env": command.env,
        "env_kwargs": env_kwargs,
        "joints": joints,
        "episode_steps": env.spec.max_episode_steps,
        "n_envs": command.envs or config.get("n_envs", 1),
        "n_timesteps": int(float(config.get("n_timesteps", 1e6))),
        "minutes": None,
        "save_every": 20_000,
        "eval_every": 10_000,
        "eval_episodes": 20,
        **overrides(command),
        "demos": None if command.demos is None else str(command.demos),
        "demo_share": config.get("demo_share", 0.5),
        "seed": command.seed,
        "hyperparameters": {key: value for key, value in config.items() if key not in OUR_KEYS},
    }


def resumed_settings(command: TrainRlOptions) -> dict[str, Any]:
    """Settings of a run that is to go on."""
    last_checkpoint(command.run)
    return {**read_run(command.run), **overrides(command)}


def overrides(command: TrainRlOptions) -> dict[str, Any]:
    """Settings that the command line gives, and that a resumption may give anew."""
    given = {
        "n_timesteps": command.steps,
        "minutes": command.minutes,
        "save_every": command.save_every,
        "eval_every": command.eval_every,
        "eval_episodes": command.eval_episodes,
    }
    return {key: value for key, value in given.items() if value is not None}


def learning_envs(settings: dict[str, Any]) -> VecEnv:
    """The environments that are learnt in, each in a process of its own if there are several."""
    from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecMonitor

    from regrasp_train.rl_envs import make_learning_env

    makers = [partial(make_learning_env, settings["env"], settings["env_kwargs"]) for _ in range(settings["n_envs"])]
    envs = DummyVecEnv(makers) if len(makers) == 1 else SubprocVecEnv(makers, start_method="spawn")
    return VecMonitor(envs, info_keywords=("is_success",))


def new_model(settings: dict[str, Any], envs: VecEnv, command: TrainRlOptions) -> tuple[BaseAlgorithm, Clock, float]:
    """An untrained model, with demonstrations if there are any; a new clock; the best return so far."""
    from stable_baselines3 import PPO

    from regrasp_train.checkpoints import Clock
    from regrasp_train.goal_features import GoalFeatures

    clock = Clock()
    options = dict(settings["hyperparameters"])
    options["policy_kwargs"] = {
        "features_extractor_class": GoalFeatures,
        "features_extractor_kwargs": {"joints": settings["joints"]},
        **options.get("policy_kwargs", {}),
    }
    options |= {"seed": settings["seed"], "device": command.device, "tensorboard_log": str(command.run)}
    made = PPO(env=envs, **options) if settings["algo"] == "ppo" else new_sac(settings, envs, options)
    return made, clock, -np.inf


def new_sac(settings: dict[str, Any], envs: VecEnv, options: dict[str, Any]) -> BaseAlgorithm:
    """An untrained model that learns from its replay buffer."""
    from stable_baselines3 import SAC

    from regrasp_train.demonstrations import DemonstrationReplayBuffer
    from regrasp_train.goal_features import NormalizedReLU

    options["policy_kwargs"] = {"activation_fn": NormalizedReLU, **options["policy_kwargs"]}
    # Goals are relabelled with what an episode came to: one has to be over in each environment.
    first = settings["n_envs"] * (settings["episode_steps"] + 1)
    options["learning_starts"] = max(options.get("learning_starts", 0), first)
    buffer = {**options.pop("replay_buffer_kwargs", {}), "demo_share": settings["demo_share"]}
    model = SAC(env=envs, replay_buffer_class=DemonstrationReplayBuffer, replay_buffer_kwargs=buffer, **options)
    if settings["demos"] is not None:
        fill(model, settings, envs)
    return model


def fill(model: Any, settings: dict[str, Any], envs: VecEnv) -> None:
    """Fill a model's replay buffer with demonstrations."""
    from regrasp_train.demonstrations import demonstration_buffer, read_demonstrations
    from regrasp_train.rl_envs import make_learning_env

    env = make_learning_env(settings["env"], settings["env_kwargs"])
    try:
        episodes = read_demonstrations(Path(settings["demos"]), env)
    finally:
        env.close()
    model.replay_buffer.demos = demonstration_buffer(episodes, model.replay_buffer, envs)
    frames = sum(map(len, episodes))
    Console().print(f"{len(episodes)} demonstrations succeed again: {frames} transitions in the replay buffer")


def restored(settings: dict[str, Any], envs: VecEnv, command: TrainRlOptions) -> tuple[BaseAlgorithm, Clock, float]:
    """The model of the last checkpoint with its replay buffer, the clock as it stood, and the best return till then."""
    from stable_baselines3 import PPO, SAC

    from regrasp_train.checkpoints import Clock
    from regrasp_train.learning_curve import read_points

    checkpoint = last_checkpoint(command.run)
    made = {"sac": SAC, "ppo": PPO}[settings["algo"]]
    model = made.load(checkpoint / MODEL, env=envs, device=command.device, tensorboard_log=str(command.run))
    if isinstance(model, SAC):
        # Its last episode was not finished: that is what happens to a run that stops.
        warnings.filterwarnings("ignore", "(?s).*last trajectory in the replay buffer")
        model.load_replay_buffer(checkpoint / BUFFER)
        demos = getattr(model.replay_buffer, "demos", None)
        if demos is not None:
            demos.device = model.device
    progress = json.loads((checkpoint / PROGRESS).read_text())
    # The model's own seed would draw the scenes and the noise of the run's beginning again.
    model.set_random_seed(settings["seed"] + progress["steps"])
    curve = command.run / CURVE_FILE
    if curve.exists():
        # Evaluations after the checkpoint are made again.
        rewrite_lines(curve, read_points(curve, progress["steps"]))
    Console().print(f"Going on from step {progress['steps']}", highlight=False)
    return model, Clock(progress["seconds"]), -np.inf if progress["best"] is None else progress["best"]


def check_report(command: TrainRlOptions) -> None:
    """Raise `RunError` or `BenchError` if the learning curve could not be reported as asked for at the end."""
    from regrasp_gym.reports.plots import check_format

    check_format(command.plot)
    names = [command.run.name]
    for run in command.compare:
        if not (run / CURVE_FILE).exists():
            raise RunError(f"--compare {run} has no learning curve: give the folder of a run of regrasp-train-rl")
        if run.name in names:
            raise RunError(f"--compare {run}: another run is called {run.name}, too; rename its folder")
        names.append(run.name)


def report(command: TrainRlOptions, clock: Clock) -> None:
    """Say how well it went, and write the learning curve where it was asked for."""
    from regrasp_gym.reports.report import write_report
    from regrasp_train.learning_curve import curve_report, plot_curves, read_points

    curves = {run.name: read_points(run / CURVE_FILE) for run in (command.run, *command.compare)}
    curves = {name: points for name, points in curves.items() if points}
    for name, points in curves.items():
        last = points[-1]
        told = f"{name}: {last.successes} of {last.episodes} succeed after {last.steps} steps"
        Console().print(told, highlight=False)
    best = command.run / "best" / "best_model.zip"
    policy = best if best.exists() else command.run / "model.zip"
    Console().print(f"regrasp-eval --policy {policy} tells how well it does", highlight=False, soft_wrap=True)
    summary: dict[str, Any] = {
        "settings": read_run(command.run),
        "seconds": clock.seconds,
        "curves": {name: curve_report(points) for name, points in curves.items()},
    }
    packages = ("regrasp-gym", "mujoco", "gymnasium", "stable-baselines3", "torch", "numpy")
    write_report(command.json_file, summary, packages)
    if curves:
        plot_curves(curves, command.plot, read_run(command.run)["env"])


if __name__ == "__main__":
    sys.exit(main())
