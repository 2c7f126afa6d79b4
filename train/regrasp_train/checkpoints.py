"""Checkpoints of reinforcement learning: what a run needs to go on, whole or not there at all."""

from __future__ import annotations

import json
import shutil
import time
from pathlib import Path
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback, EvalCallback

from regrasp_train.errors import RunError
from regrasp_train.learning_curve import CurvePoint, append_point

RUN_FILE = "run.json"
CURVE_FILE = "curve.jsonl"
MODEL, BUFFER, PROGRESS = "model.zip", "replay_buffer.pkl", "progress.json"


class Clock:
    """Seconds learnt so far, those before a resumption included."""

    def __init__(self, before: float = 0.0) -> None:
        self._before, self._began = before, time.monotonic()

    @property
    def seconds(self) -> float:
        """Since the run first began, but for the time it lay still."""
        return self._before + time.monotonic() - self._began


class Checkpoints(BaseCallback):
    """Every so many steps, and at the end: the model and the replay buffer.

    Stable-Baselines3's own callback writes its files one after the other into place, and a run that is killed
    meanwhile can not go on from them. Here a folder appears by one rename. Models stay, buffers only with the last.

    Args:
        folder: where they are kept.
        every: steps between them.
        clock: of the run.
        budget: seconds of the clock after which learning stops; None for no limit.
    """

    def __init__(self, folder: Path, every: int, clock: Clock, budget: float | None = None) -> None:
        super().__init__()
        self.folder, self.every, self.clock, self.budget = folder, every, clock, budget
        self._due = 0

    def _on_training_start(self) -> None:
        self._due = self.model.num_timesteps + self.every

    def _on_step(self) -> bool:
        if self.model.num_timesteps >= self._due:
            self._due = self.model.num_timesteps + self.every
            self.save()
        return self.budget is None or self.clock.seconds < self.budget

    def _on_training_end(self) -> None:
        self.save()

    def save(self) -> None:
        """Write a checkpoint of now."""
        steps = self.model.num_timesteps
        place = self.folder / f"{steps:09d}"
        if place.exists():
            return
        unfinished = self.folder / "unfinished"
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        self.model.save(unfinished / MODEL)
        if getattr(self.model, "replay_buffer", None) is not None:
            self.model.save_replay_buffer(unfinished / BUFFER)  # type: ignore[attr-defined]
        (unfinished / PROGRESS).write_text(json.dumps({"steps": steps, "seconds": self.clock.seconds}) + "\n")
        unfinished.rename(place)
        for other in checkpoints_in(self.folder):
            if other != place:
                (other / BUFFER).unlink(missing_ok=True)


class CurvePoints(BaseCallback):
    """After each evaluation of an `EvalCallback`: a point of the learning curve."""

    def __init__(self, file: Path, clock: Clock) -> None:
        super().__init__()
        self.file, self.clock = file, clock

    def _on_step(self) -> bool:
        assert isinstance(self.parent, EvalCallback)
        successes = self.parent.evaluations_successes[-1]
        point = CurvePoint(self.num_timesteps, self.clock.seconds, len(successes), int(sum(map(bool, successes))))
        append_point(self.file, point)
        return True


def checkpoints_in(folder: Path) -> list[Path]:
    """Finished checkpoints, oldest first."""
    return sorted(path for path in folder.glob("[0-9]*") if (path / PROGRESS).exists())


def last_checkpoint(run: Path) -> Path:
    """The checkpoint that a run goes on from.

    Raises:
        RunError: there is none.
    """
    found = checkpoints_in(run / "checkpoints")
    if not found:
        raise RunError(f"{run} holds no checkpoint to go on from; begin it anew without --resume")
    return found[-1]


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
