"""The folder of a run: who may write there, and what is where in one of reinforcement learning."""

from __future__ import annotations

import contextlib
import fcntl
import json
from collections.abc import Generator
from pathlib import Path
from typing import Any

from regrasp_train.errors import RunError

RUN_FILE = "run.json"
"""What the run was told."""
CURVE_FILE = "curve.jsonl"
"""Its learning curve."""
CHECKPOINTS = "checkpoints"
"""Folder of its checkpoints, one folder each."""
MODEL, BUFFER, PROGRESS = "model.zip", "replay_buffer.pkl", "progress.json"
"""What is in a checkpoint."""


def check_new(run: Path, resumable: bool) -> None:
    """Raise `RunError` if there is such a folder already; it may say whether a checkpoint in it can be resumed."""
    if run.exists():
        state = ": add --resume to go on with it, or" if resumable else " and holds no checkpoint to go on from:"
        raise RunError(f"{run} exists already{state} choose another --run")


@contextlib.contextmanager
def held(run: Path) -> Generator[None]:
    """Hold the folder of a run, which need not exist yet, against other processes.

    Raises:
        RunError: another process holds it.
    """
    run.parent.mkdir(parents=True, exist_ok=True)
    # Beside the folder, because LeRobot's trainer wants to make that itself.
    with run.with_name(f".{run.name}.lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise RunError(f"another training is at work in {run}: choose another --run") from error
        yield


def write_run(run: Path, settings: dict[str, Any]) -> None:
    """Keep what a run is told, in its folder."""
    run.mkdir(exist_ok=True)
    temporary = (run / RUN_FILE).with_suffix(".tmp")
    temporary.write_text(json.dumps(settings, indent=2) + "\n")
    temporary.replace(run / RUN_FILE)


def read_run(path: Path) -> dict[str, Any]:
    """What the run that a checkpoint belongs to was told, from the nearest folder that says so.

    Args:
        path: of a run, of a checkpoint, or of a file in one.

    Raises:
        RunError: no folder above it is one of a run.
    """
    for folder in (path, *path.resolve().parents[:3]):
        if (folder / RUN_FILE).is_file():
            return json.loads((folder / RUN_FILE).read_text())
    raise RunError(f"{path} belongs to no run of regrasp-train-rl: there is no {RUN_FILE} in the folders above it")


def checkpoints_in(run: Path) -> list[Path]:
    """Finished checkpoints, oldest first."""
    return sorted(path for path in (run / CHECKPOINTS).glob("[0-9]*") if (path / PROGRESS).exists())


def last_checkpoint(run: Path) -> Path:
    """The checkpoint that a run goes on from.

    Raises:
        RunError: there is none.
    """
    found = checkpoints_in(run)
    if not found:
        raise RunError(
            f"{run} holds no checkpoint of regrasp-train-rl to go on from: begin another --run without --resume"
        )
    return found[-1]
