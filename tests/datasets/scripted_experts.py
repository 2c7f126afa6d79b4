"""Experts without a planner: they move the real robot in the real environment, and claim nothing about success."""

from __future__ import annotations

import time
from types import SimpleNamespace

import numpy as np

STEPS = 12


class WavingExpert:
    """Waves the arm, closing the hand halfway; seeds divisible by 3 plan one stage, others two, seed 4 none."""

    pause = 0.0

    def __init__(self, env, strategy: str = "static", seed: int = 0) -> None:
        self._env = env.unwrapped
        self.failure = None
        self.plan = None
        self.stage_index = 0
        self._step = 0

    def reset(self) -> bool:
        seed = self._env.scene.seed
        if seed == 4:
            self.failure = "no grasp found"
            return False
        stages = 1 if seed % 3 == 0 else 2
        self.plan = SimpleNamespace(stages=[None] * stages)
        self._step = 0
        self._start = self._env.command
        self._turn = 0.3 + 0.01 * seed
        return True

    def act(self, obs):
        if self._step == STEPS:
            return None
        time.sleep(self.pause)
        command = self._start.copy()
        command[0] += self._turn * np.sin(0.4 * self._step)
        command[-1] *= 0.5
        self.stage_index = min(2 * self._step // STEPS, len(self.plan.stages) - 1)
        self._step += 1
        return command


class SlowExpert(WavingExpert):
    """Takes a while, so that there is time to interrupt it."""

    pause = 0.15


class CrashingExpert(WavingExpert):
    """Has a bug."""

    def act(self, obs):
        raise ZeroDivisionError("division by zero")
