"""``regrasp-train-bc``: behaviour cloning with LeRobot's own trainer, its arguments filled in for our environments."""

from __future__ import annotations

import json
import logging
import os
import shlex
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console

from regrasp_datasets.quiet import quiet_environment
from regrasp_gym.reports.command_line import JsonFile, require_extra, run_command
from regrasp_gym.reports.report import write_report
from regrasp_train.configs import read_config
from regrasp_train.errors import MismatchError, RunError
from regrasp_train.run_folder import check_new, lock_run
from regrasp_train.scenes import held_out
from regrasp_train.threads import threads

PLUGIN = "regrasp_datasets.lerobot_env"
"""Module that LeRobot imports to know the environments."""


@dataclass(frozen=True)
class TrainBcOptions:
    """Train a policy on demonstrations with LeRobot's trainer.

    Prints and runs lerobot-train with the arguments for a dataset of regrasp-collect and its environment. Checkpoints
    are LeRobot's own: regrasp-eval and lerobot-eval take RUN/checkpoints/last/pretrained_model.
    """

    run: Path
    """Folder of the run; it must not exist, unless --resume is given."""
    dataset: Path | None = None
    """Folder of the dataset; not needed with --resume."""
    env: str | None = None
    """Gymnasium id, by default that of the dataset; its features must be the dataset's."""
    config: str = "bc-state"
    """Hyper-parameters: bc-state, bc-images, or a YAML file like them."""
    steps: int | None = None
    """Training steps, instead of the config's."""
    batch_size: int | None = None
    """Frames per step, instead of the config's."""
    save_every: int | None = None
    """Steps between checkpoints, instead of the config's."""
    eval_every: int = 0
    """Steps between evaluations in validation scenes; 0 for none."""
    eval_episodes: int = 10
    """Episodes of each of these evaluations."""
    device: str | None = None
    """cpu, cuda or mps; by default the best available."""
    seed: int = 0
    """Seed of weights and of the order of the data."""
    resume: bool = False
    """Continue from the last checkpoint of the run; only --steps and --save-every can be changed."""
    json_file: JsonFile = None
    """Write the arguments of lerobot-train, the policy and the time as JSON."""


def main() -> int:
    """Entry point of ``regrasp-train-bc``: 0 if done, 2 for wrong use, 130 for Ctrl-C."""
    ours, extra = _split(sys.argv[1:])
    options = tyro.cli(TrainBcOptions, prog="regrasp-train-bc", description=TrainBcOptions.__doc__, args=ours)
    shows_progress = "TQDM_DISABLE" not in os.environ
    quiet_environment()
    if shows_progress:
        del os.environ["TQDM_DISABLE"]
    resume = f"go on with --run {options.run} --resume"
    return run_command("regrasp-train-bc", lambda: train(options, extra), resume=resume)


def train(options: TrainBcOptions, extra: Sequence[str] = ()) -> int:
    """Train a policy and report. Returns 0.

    Args:
        options: command-line options.
        extra: further arguments for LeRobot's trainer.

    Raises:
        MissingExtraError: LeRobot is not installed.
        RunError: the folder of the run, or the config, cannot be used.
        MismatchError: the environment's features are not those of the dataset.
        DatasetError: there is no finished dataset.
        RolloutError: the environment cannot be made.
    """
    require_extra("regrasp-train-bc", "lerobot")
    arguments = [*(resumed(options) if options.resume else fresh(options)), *extra]
    Console().print(f"lerobot-train {shlex.join(arguments)}", highlight=False, soft_wrap=True)

    # Without FFmpeg, LeRobot prints a long note that it reads films with PyAV.
    logging.getLogger("lerobot.utils.import_utils").setLevel(logging.ERROR)
    import torch
    from lerobot.scripts.lerobot_train import train as lerobot_train

    torch.set_num_threads(threads())
    # LeRobot's trainer reads the command line again when it resumes.
    started, before = time.perf_counter(), sys.argv
    sys.argv = ["lerobot-train", *arguments]
    try:
        with lock_run(options.run):
            lerobot_train()  # pyright: ignore[reportCallIssue]
    finally:
        sys.argv = before
    policy = saved_config(options.run).parent
    Console().print(f"regrasp-eval --policy {policy} evaluates it", highlight=False, soft_wrap=True)
    summary = {"lerobot_train": arguments, "policy": policy, "seconds": time.perf_counter() - started}
    write_report(options.json_file, summary, ("regrasp-gym", "mujoco", "gymnasium", "lerobot", "torch", "numpy"))
    return 0


def fresh(options: TrainBcOptions) -> list[str]:
    """Arguments of LeRobot's trainer for a new run."""
    from regrasp_datasets.records import read_episodes, repo_id_of

    if options.dataset is None:
        raise RunError("--dataset is missing: give the folder of a dataset, made by regrasp-collect")
    check_new(options.run, resumable=saved_config(options.run).exists())
    records = read_episodes(options.dataset)
    config = read_config(options.config)
    if not {"obs_type", "train"} <= set(config):
        raise RunError(f"config {options.config!r} is not one of behaviour cloning: it lacks 'obs_type' or 'train'")
    device = options.device or best_device()
    env_id = options.env or records[0].env_id
    recorded = records[0].env_kwargs
    obs_type = config["obs_type"]
    inputs = check_dataset(options.dataset, env_id, recorded, obs_type)
    image_size = recorded.get("image_size", (128, 128))[0]
    # LeRobot evaluates in scenes from its seed on. They must not be those of the demonstrations.
    first, of_split = held_out(env_id, "val")
    settings = merged(config["train"], config.get("gpu", {})) if device != "cpu" else config["train"]
    settings = merged(
        {"num_workers": 0, "seed": first + options.seed, "wandb": {"enable": False}},
        settings,
        {
            "dataset": {"repo_id": repo_id_of(options.dataset), "root": str(options.dataset)},
            "output_dir": str(options.run),
            "policy": {"device": device, "push_to_hub": False, "input_features": inputs},
            "env": {
                "discover_packages_path": PLUGIN,
                "type": "regrasp",
                "task": env_id.removeprefix("regrasp_gym/"),
                "obs_type": obs_type,
                "control_mode": recorded.get("control_mode", "joint_pos"),
                "image_size": image_size,
                **of_split,
            },
            "env_eval_freq": options.eval_every,
            "eval": {"n_episodes": options.eval_episodes, "batch_size": 2},
        },
    )
    chosen = {"steps": options.steps, "batch_size": options.batch_size, "save_freq": options.save_every}
    settings = merged(settings, {key: value for key, value in chosen.items() if value is not None})
    return flattened(settings)


def resumed(options: TrainBcOptions) -> list[str]:
    """Arguments of LeRobot's trainer for a resumed run."""
    saved = saved_config(options.run)
    if not saved.exists():
        raise RunError(
            f"{options.run} holds no checkpoint of regrasp-train-bc ({saved} is missing): start another --run "
            "without --resume"
        )
    arguments = [f"--env.discover_packages_path={PLUGIN}", f"--config_path={saved}", "--resume=true"]
    chosen = {"steps": options.steps, "save_freq": options.save_every}
    return arguments + flattened({key: value for key, value in chosen.items() if value is not None})


def saved_config(run: Path) -> Path:
    """File of LeRobot's with the configuration of a run; exists once there is a checkpoint."""
    return run / "checkpoints" / "last" / "pretrained_model" / "train_config.json"


def check_dataset(root: Path, env_id: str, recorded: dict[str, Any], obs_type: str) -> dict[str, Any]:
    """Check that a dataset has the environment's features.

    Args:
        root: folder of the dataset.
        env_id: Gymnasium id of the environment.
        recorded: keyword arguments of ``gym.make`` that the dataset was recorded with.
        obs_type: observations of the policy, as in `regrasp_datasets.lerobot_env`.

    Returns:
        Type and shape of the policy's inputs, by feature.

    Raises:
        MismatchError: a feature differs, or the policy needs images and the dataset has none.
    """
    from lerobot.utils.feature_utils import dataset_to_policy_features

    from regrasp_datasets.features import ACTION, ENVIRONMENT_STATE, IMAGE_PREFIX, STATE, features_of
    from regrasp_datasets.rollout import make_env

    table = json.loads((root / "meta" / "info.json").read_text())["features"]
    images = "pixels" in obs_type
    if images and not any(key.startswith(IMAGE_PREFIX) for key in table):
        raise MismatchError(f"{root} holds no images: train with --config bc-state, or collect without --no-images")
    kwargs = {key: value for key, value in recorded.items() if key in ("control_mode", "image_size")}
    env = make_env(env_id, kwargs | {"obs_type": "pixels_agent_pos" if images else "state"})
    features = features_of(env)
    env.close()
    wanted = {STATE, ACTION} | ({ENVIRONMENT_STATE} if "environment_state" in obs_type else set())
    wanted |= {key for key in features if images and key.startswith(IMAGE_PREFIX)}
    for key in sorted(wanted):
        have = (tuple(table[key]["shape"]), table[key]["names"]) if key in table else None
        needs = (tuple(features[key]["shape"]), features[key]["names"])
        if have != needs:
            raise MismatchError(
                f"{root} does not fit {env_id}: its {key} is {describe(have)}, the environment's {describe(needs)}. "
                "Give --env the environment it was collected in, or collect in this one."
            )
    inputs = dataset_to_policy_features({key: features[key] for key in sorted(wanted - {ACTION})})
    return {key: {"type": feature.type.value, "shape": list(feature.shape)} for key, feature in inputs.items()}


def describe(feature: tuple[tuple[int, ...], list[str] | None] | None) -> str:
    """A feature's shape and the names of its first entries, for messages."""
    if feature is None:
        return "missing"
    shape, names = feature
    return f"{shape}" + (f" of {', '.join(names[:3])}, …" if names else "")


def best_device() -> str:
    """Fastest device of torch on this machine."""
    import torch

    return (torch.accelerator.current_accelerator(check_available=True) or torch.device("cpu")).type


def merged(*tables: dict[str, Any]) -> dict[str, Any]:
    """Merge nested tables; entries of later ones win."""
    result: dict[str, Any] = {}
    for table in tables:
        for key, value in table.items():
            old = result.get(key)
            result[key] = merged(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return result


def flattened(settings: dict[str, Any], prefix: str = "") -> list[str]:
    """Settings as command-line arguments. Tables that LeRobot reads whole stay JSON."""
    arguments: list[str] = []
    for key, value in settings.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict) and key not in ("input_features", "normalization_mapping"):
            arguments += flattened(value, f"{name}.")
        else:
            arguments.append(f"--{name}={value if isinstance(value, str) else json.dumps(value)}")
    return arguments


def _split(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Arguments before and after ``--``."""
    arguments = list(arguments)
    at = arguments.index("--") if "--" in arguments else len(arguments)
    return arguments[:at], arguments[at + 1 :]


if __name__ == "__main__":
    sys.exit(main())
