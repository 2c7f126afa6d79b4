"""Checkpoints of reinforcement learning, written whole or not at all."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

from stable_baselines3.common.callbacks import BaseCallback, EvalCallback

from regrasp_gym.reports.files import append_line, write_json
from regrasp_train.learning_curve import CurvePoint
from regrasp_train.run_folder import BUFFER, CHECKPOINTS, MODEL, PROGRESS, checkpoints_in


class Clock:
    """Time spent in a run, earlier sessions included."""

    def __init__(self, before: float = 0.0) -> None:
        self._before, self._began = before, time.monotonic()

    @property
    def seconds(self) -> float:
        """Seconds so far."""
        return self._before + time.monotonic() - self._began


class Checkpoints(BaseCallback):
    """Saves the model and the replay buffer at the start, every so many steps, and at the end.

    Stable-Baselines3's own callback writes files in place, so a run killed meanwhile cannot be resumed. Here a folder
    appears by one rename. All models are kept, but only the last replay buffer.

    Args:
        run: folder of the run.
        every: steps between checkpoints.
        clock: clock of the run.
        evaluation: holds the best mean return so far.
        budget: seconds of the clock after which training stops; None for no limit.
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
        """Write a checkpoint, unless there is one of this step."""
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
        # Before the first evaluation the best return is −∞, which is written as null.
        progress = {"steps": steps, "seconds": self.clock.seconds, "best": float(self.evaluation.best_mean_reward)}
        write_json(unfinished / PROGRESS, progress)
        unfinished.rename(place)
        for other in checkpoints_in(self.run):
            if other != place:
                (other / BUFFER).unlink(missing_ok=True)


class CurvePoints(BaseCallback):
    """Appends a point to the learning curve after each evaluation of an `EvalCallback`."""

    def __init__(self, file: Path, clock: Clock) -> None:
        super().__init__()
        self.file, self.clock = file, clock

    def _on_step(self) -> bool:
        assert isinstance(self.parent, EvalCallback)
        successes = self.parent.evaluations_successes[-1]
        point = CurvePoint(self.num_timesteps, self.clock.seconds, len(successes), int(sum(map(bool, successes))))
        append_line(self.file, point)
        return True
