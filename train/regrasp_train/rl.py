"""``regrasp-train-rl``: reinforcement learning with Stable-Baselines3."""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro
from rich.console import Console

from regrasp_datasets.quiet import quiet_environment
from regrasp_gym.reports.command_line import JsonFile, require_extra, run_command
from regrasp_train.configs import read_config
from regrasp_train.errors import RunError
from regrasp_train.run_folder import (
    CURVE_FILE,
    check_new,
    checkpoints_in,
    last_checkpoint,
    lock_run,
    read_run,
    write_run,
)
from regrasp_train.threads import threads

if TYPE_CHECKING:
    from regrasp_train.checkpoints import Clock

OUR_KEYS = ("n_envs", "n_timesteps", "env_kwargs", "demo_share")
"""Hyper-parameters that are not Stable-Baselines3's."""


@dataclass(frozen=True)
class TrainRlOptions:
    """Train a policy by reinforcement learning with Stable-Baselines3: SAC with hindsight experience replay, or PPO.

    The learning curve is the success on validation scenes during training. Checkpoints include the replay buffer, so
    --resume continues a killed run. The last model is RUN/model.zip, the best on validation scenes
    RUN/best/best_model.zip; regrasp-eval takes either.
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
    """Stop after this time, which counts over resumptions."""
    envs: int | None = None
    """Parallel environments, instead of the config's."""
    save_every: int | None = None
    """Steps between checkpoints; 20,000 by default."""
    eval_every: int | None = None
    """Steps between evaluations; 10,000 by default."""
    eval_episodes: int | None = None
    """Episodes of each evaluation, on validation scenes; 20 by default."""
    seed: int = 0
    """Seed of weights, exploration and scenes."""
    device: str = "auto"
    """cpu, cuda or mps; by default the best available."""
    resume: bool = False
    """Continue from the last checkpoint of the run. Only --steps, --minutes, --save-every, --eval-every and
    --eval-episodes can be changed."""
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
    options = tyro.cli(TrainRlOptions, prog="regrasp-train-rl", description=TrainRlOptions.__doc__)
    quiet_environment()
    return run_command("regrasp-train-rl", lambda: train(options), resume=f"go on with --run {options.run} --resume")


def train(options: TrainRlOptions) -> int:
    """Train a policy and report. Returns 0.

    Raises:
        MissingExtraError: Stable-Baselines3, or LeRobot for demonstrations, is not installed.
        RunError: the folder of the run or of one to compare with, or the config, cannot be used.
        MismatchError: the demonstrations are of another environment.
        RolloutError: the environment cannot be made.
        BenchError: the picture has an unknown suffix.
    """
    require_extra("regrasp-train-rl", "rl")
    if options.demos is not None:
        require_extra("regrasp-train-rl --demos", "lerobot")
    check_report(options)
    settings = resumed_settings(options) if options.resume else new_settings(options)
    import torch
    from stable_baselines3.common.callbacks import CallbackList, EvalCallback
    from stable_baselines3.common.vec_env import DummyVecEnv

    from regrasp_train.checkpoints import Checkpoints, CurvePoints
    from regrasp_train.rl_envs import make_eval_env, make_learning_envs
    from regrasp_train.rl_models import new_model, restored

    torch.set_num_threads(threads())
    with lock_run(options.run):
        write_run(options.run, settings)
        envs = make_learning_envs(settings)
        # A single environment evaluates fastest, whatever the number to learn in.
        warnings.filterwarnings("ignore", "Training and eval env are not of the same type")
        episodes = settings["eval_episodes"]
        eval_env = DummyVecEnv([partial(make_eval_env, settings["env"], settings["env_kwargs"], episodes)])
        try:
            model, clock, best = (restored if options.resume else new_model)(settings, envs, options)
            evaluation = EvalCallback(
                eval_env,
                callback_after_eval=CurvePoints(options.run / CURVE_FILE, clock),
                n_eval_episodes=episodes,
                eval_freq=max(settings["eval_every"] // envs.num_envs, 1),
                log_path=str(options.run / "evaluations"),  # successes are counted only with one
                best_model_save_path=str(options.run / "best"),
                verbose=0,
            )
            evaluation.best_mean_reward = best
            budget = None if settings["minutes"] is None else 60 * settings["minutes"]
            checkpoints = Checkpoints(options.run, settings["save_every"], clock, evaluation, budget)
            total = settings["n_timesteps"]
            told = f"{settings['algo'].upper()} in {settings['env']}, {total} steps; tensorboard --logdir {options.run}"
            Console().print(told, highlight=False, soft_wrap=True)
            if model.num_timesteps >= total:
                Console().print(f"The run has {model.num_timesteps} steps already: give more with --steps")
            else:
                model.learn(
                    total - model.num_timesteps,
                    callback=CallbackList([evaluation, checkpoints]),
                    reset_num_timesteps=False,
                    tb_log_name="tensorboard",
                    progress_bar=options.progress,
                )
            model.save(options.run / "model.zip")
        finally:
            envs.close()
            eval_env.close()
    report(options, clock)
    return 0


def new_settings(options: TrainRlOptions) -> dict[str, Any]:
    """Settings of a new run, which are checked."""
    from regrasp_datasets.features import base_env
    from regrasp_datasets.rollout import make_env

    check_new(options.run, resumable=bool(checkpoints_in(options.run)))
    if options.demos is not None and options.algo != "sac":
        raise RunError(f"--demos needs a replay buffer, which --algo {options.algo} lacks: use --algo sac")
    by_env = read_config(options.config or options.algo)
    config = by_env.get(options.env, by_env.get("default"))
    if config is None:
        name = options.config or options.algo
        raise RunError(f"config {name!r} has no table {options.env!r} and no table 'default', as shipped sac.yml has")
    env_kwargs = config.get("env_kwargs", {})
    env = make_env(options.env, {**env_kwargs, "obs_type": "state"})
    joints = len(base_env(env).scenario.robot.arm_joints)
    env.close()
    assert env.spec is not None, "an environment made by its id has a specification"
    if options.demos is not None:
        from regrasp_train.demonstrations import check_demonstrations

        check_demonstrations(options.demos, options.env, env_kwargs.get("control_mode", "joint_pos"))
    return {
        "algo": options.algo,
        "env": options.env,
        "env_kwargs": env_kwargs,
        "joints": joints,
        "episode_steps": env.spec.max_episode_steps,
        "n_envs": options.envs or config.get("n_envs", 1),
        "n_timesteps": int(float(config.get("n_timesteps", 1e6))),
        "minutes": None,
        "save_every": 20_000,
        "eval_every": 10_000,
        "eval_episodes": 20,
        **overrides(options),
        "demos": None if options.demos is None else str(options.demos),
        "demo_share": config.get("demo_share", 0.5),
        "seed": options.seed,
        "hyperparameters": {key: value for key, value in config.items() if key not in OUR_KEYS},
    }


def resumed_settings(options: TrainRlOptions) -> dict[str, Any]:
    """Settings of a run that is resumed."""
    last_checkpoint(options.run)
    return {**read_run(options.run), **overrides(options)}


def overrides(options: TrainRlOptions) -> dict[str, Any]:
    """Settings given on the command line that may change when a run is resumed."""
    given = {
        "n_timesteps": options.steps,
        "minutes": options.minutes,
        "save_every": options.save_every,
        "eval_every": options.eval_every,
        "eval_episodes": options.eval_episodes,
    }
    return {key: value for key, value in given.items() if value is not None}


def check_report(options: TrainRlOptions) -> None:
    """Check before training that the learning curve can be reported.

    Raises:
        RunError: a run to compare with has no learning curve, or the name of another.
        BenchError: the picture has an unknown suffix.
    """
    from regrasp_gym.reports.plots import check_format

    check_format(options.plot)
    names = [options.run.name]
    for run in options.compare:
        if not (run / CURVE_FILE).exists():
            raise RunError(f"--compare {run} has no learning curve: give the folder of a run of regrasp-train-rl")
        if run.name in names:
            raise RunError(f"--compare {run}: another run is also called {run.name}; rename its folder")
        names.append(run.name)


def report(options: TrainRlOptions, clock: Clock) -> None:
    """Print the success of the run, and write its learning curve if asked for."""
    from regrasp_gym.reports.report import write_report
    from regrasp_train.learning_curve import curve_report, plot_curves, read_points

    curves = {run.name: read_points(run / CURVE_FILE) for run in (options.run, *options.compare)}
    curves = {name: points for name, points in curves.items() if points}
    for name, points in curves.items():
        last = points[-1]
        told = f"{name}: {last.successes} of {last.episodes} succeed after {last.steps} steps"
        Console().print(told, highlight=False)
    best = options.run / "best" / "best_model.zip"
    policy = best if best.exists() else options.run / "model.zip"
    Console().print(f"regrasp-eval --policy {policy} evaluates it", highlight=False, soft_wrap=True)
    summary: dict[str, Any] = {
        "settings": read_run(options.run),
        "seconds": clock.seconds,
        "curves": {name: curve_report(points) for name, points in curves.items()},
    }
    packages = ("regrasp-gym", "mujoco", "gymnasium", "stable-baselines3", "torch", "numpy")
    write_report(options.json_file, summary, packages)
    if curves:
        plot_curves(curves, options.plot, read_run(options.run)["env"])


if __name__ == "__main__":
    sys.exit(main())
