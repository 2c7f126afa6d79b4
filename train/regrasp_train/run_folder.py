"""The folder of a run: its lock, settings and checkpoints."""

from __future__ import annotations

import json
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from regrasp_gym.reports.files import acquire_lock, write_json
from regrasp_train.errors import RunError

RUN_FILE = "run.json"
"""Settings of the run."""
CURVE_FILE = "curve.jsonl"
"""Its learning curve."""
CHECKPOINTS = "checkpoints"
"""Folder of its checkpoints, one folder each."""
MODEL, BUFFER, PROGRESS = "model.zip", "replay_buffer.pkl", "progress.json"
"""Files in a checkpoint."""


def check_new(run: Path, resumable: bool) -> None:
    """Check that a run can start in a folder that does not exist.

    Args:
        run: the folder.
        resumable: whether it holds a checkpoint to resume from, for the message.

    Raises:
        RunError: it exists.
    """
    if run.exists():
        state = ": add --resume to go on with it, or" if resumable else " and holds no checkpoint to resume from:"
        raise RunError(f"{run} exists already{state} choose another --run")


@contextmanager
def lock_run(run: Path) -> Generator[None]:
    """Lock the folder of a run, which need not exist yet, against other processes.

    Raises:
        RunError: another process has locked it.
    """
    # The lock file lies beside the folder: LeRobot's trainer insists on making the folder itself.
    lock = acquire_lock(
        run.with_name(f".{run.name}.lock"), RunError(f"another training is at work in {run}: choose another --run")
    )
    try:
        yield
    finally:
        lock.release()


def write_run(run: Path, settings: dict[str, Any]) -> None:
    """Write the settings of a run into its folder."""
    write_json(run / RUN_FILE, settings)


def read_run(path: Path) -> dict[str, Any]:
    """Settings of the run that a checkpoint belongs to, from the nearest folder that holds any.

    Args:
        path: a run, a checkpoint, or a file in one.

    Raises:
        RunError: no folder above it is a run.
    """
    for folder in (path, *path.resolve().parents[:3]):
        if (folder / RUN_FILE).is_file():
            return json.loads((folder / RUN_FILE).read_text())
    raise RunError(f"{path} belongs to no run of regrasp-train-rl: there is no {RUN_FILE} in the folders above it")


def checkpoints_in(run: Path) -> list[Path]:
    """Finished checkpoints, oldest first."""
    return sorted(path for path in (run / CHECKPOINTS).glob("[0-9]*") if (path / PROGRESS).exists())


def last_checkpoint(run: Path) -> Path:
    """The newest finished checkpoint.

    Raises:
        RunError: there is none.
    """
    found = checkpoints_in(run)
    if not found:
        raise RunError(f"{run} holds no checkpoint of regrasp-train-rl: start another --run without --resume")
    return found[-1]
