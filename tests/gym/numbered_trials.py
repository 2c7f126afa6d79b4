"""Trials that leave a trace of having been run, in a module that worker processes can import."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from regrasp_gym.errors import BenchError
from regrasp_gym.reports.report import Record
from regrasp_gym.reports.trials import run_trials


def squares(setting: Record) -> Callable[[int], Record]:
    """Squares of the numbers; ``setting`` says which raise, which end their process, and how long each takes."""

    def run(trial: int) -> Record:
        with Path(setting["trace"], str(trial)).open("a") as file:
            file.write(f"{os.getpid()}\n")
        time.sleep(setting.get("pause", 0.0))
        if trial == setting.get("exits"):
            os._exit(1)
        if trial in setting.get("fails", ()):
            raise ArithmeticError(f"trial {trial} does not work")
        return {"square": np.float64(trial) ** 2, "range": np.arange(trial)}

    return run


def unprepared(setting: Record) -> Callable[[int], Record]:
    raise BenchError(f"nothing to run with in {setting['trace']}")


def slow_run(trace: Path, records: Path, workers: int) -> None:
    setting = {"trace": str(trace), "pause": 0.3}
    run_trials(setting, range(40), squares, workers=workers, records=records, label="slow")


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    from numbered_trials import slow_run as run  # under its own name, for the workers

    run(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
