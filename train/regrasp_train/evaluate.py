"""``regrasp-eval``: success rate of a policy or the expert in held-out scenes."""

from __future__ import annotations

import hashlib
import os
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Literal

import gymnasium as gym
import tyro
from rich.console import Console
from rich.table import Table

from regrasp_datasets.quiet import quiet_environment
from regrasp_datasets.rollout import make_env
from regrasp_gym.rendering.film import write_film
from regrasp_gym.reports.command_line import JsonFile, run_command
from regrasp_gym.reports.report import Record, wilson, write_report
from regrasp_gym.reports.trials import Trial, crashes, print_crashes, run_trials
from regrasp_train.agents import Agent, kind_of, make_agent, obs_type_of, trained_in
from regrasp_train.errors import MismatchError, RunError
from regrasp_train.progress import Milestone, Progress
from regrasp_train.scenes import held_out


@dataclass(frozen=True)
class EvalOptions:
    """Measure how often a policy succeeds in held-out scenes.

    An episode ends when the environment counts the task as solved. It fails at the time limit, or when the expert gives
    up. Prints the success rate with its 95 % interval (Wilson), overall and by object, and how far episodes came. The
    same command resumes an interrupted run.
    """

    policy: str
    """"expert"; a LeRobot policy (the folder …/pretrained_model); or a model .zip of regrasp-train-rl."""
    env: str | None = None
    """Gymnasium id; by default that of the training."""
    episodes: int = 50
    """Number of scenes."""
    split: Literal["train", "val", "test"] = "test"
    """Which scenes; demonstrations are collected from those of "train"."""
    seed: int = 0
    """Number of the first scene within the split."""
    control_mode: Literal["joint_pos", "ee_delta"] | None = None
    """Action space; by default that of the training."""
    workers: int = 1
    """Processes that run episodes at the same time."""
    device: str | None = None
    """Device of torch: cpu, cuda or mps."""
    videos: Path | None = None
    """Folder for films of the first episodes."""
    filmed: int = 4
    """Number of filmed episodes."""
    records: Path = Path("outputs/eval.jsonl")
    """One JSON line per episode, appended to."""
    json_file: JsonFile = None
    """Write the summary as JSON."""


def main() -> int:
    """Entry point of ``regrasp-eval``: 0 if done, 1 if episodes crashed, 2 for wrong use, 130 for Ctrl-C."""
    options = tyro.cli(EvalOptions, prog="regrasp-eval", description=EvalOptions.__doc__)
    quiet_environment()
    # Steps of an episode are sequential and small: more threads only slow each other down.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    return run_command("regrasp-eval", lambda: evaluate(options), resume="run the same command again to resume")


def evaluate(options: EvalOptions) -> int:
    """Evaluate a policy and report. Returns 0, or 1 if episodes crashed.

    Raises:
        RunError: there is no such policy.
        MismatchError: it does not fit the environment.
        RolloutError: the environment cannot be made.
        MissingExtraError: the packages for such a policy are not installed.
    """
    setting = setting_of(options)
    first, _ = held_out(setting["env"], options.split)
    # Made here to report errors at once instead of in every episode.
    env, _ = _make(setting)
    scenes = getattr(env.unwrapped, "scene_seeds", None)
    env.close()
    if scenes is not None and options.seed + options.episodes > len(scenes):
        raise MismatchError(
            f"{setting['env']} has {len(scenes)} scenes in its split {options.split!r}, too few for {options.episodes} "
            f"from number {options.seed}: give --episodes {max(len(scenes) - options.seed, 0)} or fewer"
        )
    seeds = range(first + options.seed, first + options.seed + options.episodes)
    if options.videos is not None:
        setting |= {"videos": str(options.videos), "filmed": list(seeds[: options.filmed])}
    label = "evaluating"
    records = run_trials(setting, seeds, _prepare, workers=options.workers, records=options.records, label=label)
    summary = summarise(setting, records)
    _show(summary)
    packages = ("regrasp-gym", "mujoco", "gymnasium", "jax", "numpy")
    packages += {"lerobot": ("lerobot", "torch"), "sb3": ("stable-baselines3", "torch")}.get(setting["kind"], ())
    write_report(options.json_file, summary, packages)
    return 1 if summary["crashed"] else 0


def setting_of(options: EvalOptions) -> Record:
    """Setting that all episodes share."""
    env_id, kwargs = trained_in(options.policy)
    env_id = options.env or env_id or ("regrasp_gym/PandaYCB-v0" if kind_of(options.policy) == "expert" else None)
    if env_id is None:
        raise RunError(f"{options.policy} does not name the environment that it was trained in: give --env")
    if options.control_mode is not None:
        kwargs["control_mode"] = options.control_mode
    _, of_split = held_out(env_id, options.split)
    return {
        "policy": options.policy,
        "kind": kind_of(options.policy),
        "policy_sha256": digest(options.policy),
        "env": env_id,
        "env_kwargs": {**kwargs, **of_split, "obs_type": obs_type_of(options.policy), "terminate_on_success": True},
        "split": options.split,
        "device": options.device,
        "version": version("regrasp-gym"),
    }


def digest(policy: str) -> str:
    """Digest of a policy's weights. It tells records of checkpoints with the same path apart."""
    if kind_of(policy) == "expert":
        return ""
    path = Path(policy)
    file = path if path.is_file() else path / "model.safetensors"
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16] if file.is_file() else ""


def run_episode(env: gym.Env, agent: Agent, seed: int, video: Path | None = None) -> Record:
    """Run one episode and record its outcome.

    Args:
        env: made with ``terminate_on_success``.
        agent: made for ``env``.
        seed: seed of the reset.
        video: MP4 file to write; the environment needs ``render_mode="rgb_array"``.
    """
    from regrasp_datasets.features import base_env

    inner = base_env(env)
    observation, info = env.reset(seed=seed)
    began = time.perf_counter()
    agent.reset(seed)
    progress = Progress()
    pictures = [inner.picture(inner.render_camera, *inner.render_size)] if video else []
    steps, truncated = 0, False
    while not truncated and progress.milestone is not Milestone.PLACED:
        action = agent.act(observation)
        if action is None:
            break
        observation, _, _, truncated, info = env.step(action)
        steps += 1
        progress.watch(inner)
        if video:
            pictures.append(inner.picture(inner.render_camera, *inner.render_size))
    if video:
        write_film(video, pictures, env.metadata["render_fps"])
    success = progress.milestone is Milestone.PLACED
    return {
        "seed": seed,
        "scene_seed": info["scene_seed"],
        "target": inner.scene.target.name,
        "success": success,
        "reached": str(progress.milestone),
        "steps": steps,
        "seconds": time.perf_counter() - began,
        "cause": "" if success else agent.failure or ("time limit" if truncated else "gave up"),
    }


def summarise(setting: Record, records: Sequence[Record]) -> Record:
    """Counts overall, by object and by milestone, of episodes in the order of their seeds."""
    finished = [record for record in records if "crashed" not in record]
    targets = sorted({record["target"] for record in finished})
    farthest = Counter(record["reached"] for record in finished)
    return {
        **setting,
        "seeds": [records[0]["trial"], records[-1]["trial"]] if records else [],
        **_rate(finished),
        "by_object": {name: _rate([record for record in finished if record["target"] == name]) for name in targets},
        "reached": {str(step): farthest.get(str(step), 0) for step in Milestone},
        "failures": dict(Counter(record["cause"] for record in finished if not record["success"]).most_common()),
        "failed": [record["seed"] for record in finished if not record["success"]],
        "steps_mean": sum(record["steps"] for record in finished) / max(len(finished), 1),
        "seconds_mean": sum(record["seconds"] for record in finished) / max(len(finished), 1),
        "crashed": crashes(records),
    }


def _rate(records: Sequence[Record]) -> Record:
    successes = sum(record["success"] for record in records)
    share = successes / len(records) if records else 0.0
    interval = wilson(successes, len(records))
    return {"episodes": len(records), "successes": successes, "success_rate": share, "success_rate_95": interval}


def _make(setting: Record) -> tuple[gym.Env, Agent]:
    kwargs = dict(setting["env_kwargs"])
    if "image_size" in kwargs:
        kwargs["image_size"] = tuple(kwargs["image_size"])
    if setting.get("videos"):
        kwargs["render_mode"] = "rgb_array"
    env = make_env(setting["env"], kwargs)
    return env, make_agent(setting["policy"], env, setting["device"])


def _prepare(setting: Record) -> Trial:
    env, agent = _make(setting)
    filmed, folder = setting.get("filmed", ()), Path(setting.get("videos", ""))
    return lambda seed: run_episode(env, agent, seed, folder / f"scene-{seed}.mp4" if seed in filmed else None)


def _show(summary: Record) -> None:
    console = Console()
    title = f"{summary['policy']} in {summary['env']}, {summary['split']} scenes"
    table = Table("object", "episodes", "succeed", "% (95 %)", title=title)
    for name, row in {**summary["by_object"], "all": summary}.items():
        low, high = row["success_rate_95"]
        share = f"{100 * row['success_rate']:.0f} ({100 * low:.0f}–{100 * high:.0f})"
        table.add_row(name, str(row["episodes"]), str(row["successes"]), share)
    console.print(table)
    reached = ", ".join(f"{step} {count}" for step, count in summary["reached"].items() if count)
    console.print(f"came as far as: {reached}", highlight=False)
    for cause, count in summary["failures"].items():
        console.print(f"failed: {count} × {cause}", highlight=False)
    print_crashes(summary["crashed"])


if __name__ == "__main__":
    sys.exit(main())
