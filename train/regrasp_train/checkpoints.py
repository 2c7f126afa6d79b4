"""Checkpoints of reinforcement learning: what a run needs to go on, whole or not there at all."""

from __future__ import annotations

import json
import shutil
import time
from pathlib import Path

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback, EvalCallback

from regrasp_gym.reports.files import append_line
from regrasp_train.learning_curve import CurvePoint
from regrasp_train.run_folder import BUFFER, CHECKPOINTS, MODEL, PROGRESS, checkpoints_in


class Clock:
    """Seconds learnt so far, those before a resumption included."""

    def __init__(self, before: float = 0.0) -> None:
        self._before, self._began = before, time.monotonic()

    @property
    def seconds(self) -> float:
        """Since the run first began, but for the time it lay still."""
        return self._before + time.monotonic() - self._began


class Checkpoints(BaseCallback):
    """At the beginning, every so many steps, and at the end: the model and the replay buffer.

    Stable-Baselines3's own callback writes its files one after the other into place, and a run that is killed
    meanwhile can not go on from them. Here a folder appears by one rename. Models stay, buffers only with the last.

    Args:
        run: folder of the run.
        every: steps between them.
        clock: of the run.
        evaluation: knows the best mean return so far.
        budget: seconds of the clock after which learning stops; None for no limit.
    """

    def __init__(
        self, run: Path, every: int, clock: Clock, evaluation: EvalCallback, budget: float | None = None
    ) -> None:
        super().__init__()
        self.run, self.every, self.clock, self.evaluation, self.budget = run, every, clock, evaluation, budget
        self._due = 0

    def _on_training_start(self) -> None:
        self._due = self.model.num_timesteps + self.every
        self.save()

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
        folder = self.run / CHECKPOINTS
        place = folder / f"{steps:09d}"
        if place.exists():
            return
        unfinished = folder / "unfinished"
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        self.model.save(unfinished / MODEL)
        if getattr(self.model, "replay_buffer", None) is not None:
            self.model.save_replay_buffer(unfinished / BUFFER)  # type: ignore[attr-defined]
        best = float(self.evaluation.best_mean_reward)
        progress = {"steps": steps, "seconds": self.clock.seconds, "best": best if np.isfinite(best) else None}
        (unfinished / PROGRESS).write_text(json.dumps(progress) + "\n")
        unfinished.rename(place)
        for other in checkpoints_in(self.run):
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
        append_line(self.file, point)
        return True
