"""Processes that plan with the code of this checkout or of another one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import regrasp_gym
from regrasp_bench.tables import plan_server
from regrasp_gym.errors import BenchError, OptionError
from regrasp_gym.reports.report import Record

PACKAGES = (".", "planner", "datasets", "train", "bench")
"""Folders of a checkout that hold packages."""


@dataclass(frozen=True)
class Checkout:
    """A checkout of the project, and the interpreter that runs it."""

    folder: Path
    python: str

    @staticmethod
    def this() -> Checkout:
        """The checkout of this module."""
        return Checkout(Path(regrasp_gym.__file__).parents[1], sys.executable)

    @staticmethod
    def other(folder: Path) -> Checkout:
        """The checkout in ``folder``.

        Raises:
            OptionError: there is none.
        """
        if not (folder / "regrasp_gym" / "__init__.py").is_file():
            raise OptionError(f"--against {folder} is not a checkout of regrasp-gym: it has no folder regrasp_gym")
        python = folder.resolve() / ".venv" / "bin" / "python"
        return Checkout(folder.resolve(), str(python) if python.exists() else sys.executable)

    @contextmanager
    def server(self, env_id: str, cache: Path | None = None) -> Generator[PlanServer]:
        """A process that plans with this checkout, and is killed on exit.

        Args:
            env_id: environment id.
            cache: folder of the compilation cache; None for the default.
        """
        paths = os.pathsep.join(str(self.folder / package) for package in PACKAGES)
        environment = {**os.environ, "PYTHONPATH": paths}
        if cache is not None:
            environment["REGRASP_CACHE_DIR"] = str(cache)
        command = [self.python, str(Path(plan_server.__file__)), env_id]
        with tempfile.TemporaryFile("w+") as errors:
            began = time.perf_counter()
            process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True, env=environment
            )
            try:
                yield PlanServer(process, began)
            except BrokenPipeError as error:
                errors.seek(0)
                raise BenchError(f"{self.python} in {self.folder} died: {errors.read().strip()[-500:]}") from error
            finally:
                process.kill()
                process.communicate()


class PlanServer:
    """Client of a process that runs `plan_server`."""

    def __init__(self, process: subprocess.Popen[str], began: float) -> None:
        self._process, self._began = process, began
        self.startup = self._answer()

    def plan(self, seed: int, strategy: str) -> Record:
        """Success, number of stages, and times of a plan, total and by module."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"seed": seed, "strategy": strategy}) + "\n")
        self._process.stdin.flush()
        return self._answer()

    @property
    def age(self) -> float:
        """Seconds since the start of the process."""
        return time.perf_counter() - self._began

    def _answer(self) -> Record:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise BrokenPipeError
        return json.loads(line)
