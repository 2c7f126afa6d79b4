"""What users wait for: warm plans, and the first plan of a process; beside another checkout, turn by turn."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

import regrasp_gym
from regrasp_bench.tables import plan_server
from regrasp_gym.errors import BenchError, OptionError
from regrasp_gym.reports.trials import Record, crashes, run_trials, write_report

Scenario = Literal["panda", "excavator"]
ENVS = {"panda": "regrasp_gym/PandaYCB-v0", "excavator": "regrasp_gym/ExcavatorStones-v0"}
PACKAGES = (".", "planner", "datasets", "train", "bench")
"""Folders of a checkout that Python finds packages in."""
FIRST_PLAN_SEED = 2
"""Scene of the first plan of a process: one with a regrasp."""


def plans(
    scenarios: tuple[Scenario, ...] = get_args(Scenario),
    strategies: tuple[str, ...] = ("repeated",),
    scenes: int = 50,
    first_seed: int = 0,
    starts: int = 3,
    empty_starts: int = 1,
    against: Path | None = None,
    records: Path = Path("outputs/bench/plans.jsonl"),
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> None:
    """Time warm plans by strategy and module, and the first plan of a process with a filled and an empty cache.

    Every plan is made by a process of its checkout. With AGAINST each scene is planned by both in turn, so that a
    noisy machine troubles both alike, and ratios are printed: this checkout over the other.

    Args:
        scenarios: which.
        strategies: of the warm plans.
        scenes: planned by each strategy, once untimed and once timed.
        first_seed: seed of the first scene.
        starts: processes whose first plan is timed with a filled cache.
        empty_starts: the same with an empty cache; each compiles everything.
        against: root of another checkout; its .venv/bin/python runs it, or this interpreter if it has none.
        records: one JSON line per scene or start, appended to.
        json_file: write the summary as JSON.

    Raises:
        OptionError: AGAINST is no checkout.
    """
    checkouts = [Checkout.this()] if against is None else [Checkout.this(), Checkout.other(against)]
    folders = [str(checkout.folder) for checkout in checkouts]
    report: Record = {"checkouts": folders, "scenarios": {}}
    ended: list[Record] = []
    for scenario in scenarios:
        shared: Record = {"checkouts": folders, "env": ENVS[scenario]}
        figures: Record = {}
        for strategy in strategies:
            setting: Record = {**shared, "what": "warm", "strategy": strategy}
            seeds = range(first_seed, first_seed + scenes)
            label = f"{scenario}, {strategy}"
            warm = run_trials(setting, seeds, _warm, workers=1, records=records, label=label)
            figures[f"warm, {strategy}"] = compare([trial["plans"] for trial in warm if "plans" in trial])
            ended += warm
        for what, count in (("filled cache", starts), ("empty cache", empty_starts)):
            label = f"{scenario}, first plan, {what}"
            cold = run_trials({**shared, "what": what}, range(count), _first, workers=1, records=records, label=label)
            figures[f"first plan, {what}"] = compare([trial["plans"] for trial in cold if "plans" in trial])
            ended += cold
        report["scenarios"][scenario] = figures
    report["crashed"] = crashes(ended)
    _show(report)
    write_report(json_file, report)


@dataclass(frozen=True)
class Checkout:
    """A checkout of the project, and the interpreter that runs it."""

    folder: Path
    python: str

    @staticmethod
    def this() -> Checkout:
        """The checkout that this module belongs to."""
        return Checkout(Path(regrasp_gym.__file__).parents[1], sys.executable)

    @staticmethod
    def other(folder: Path) -> Checkout:
        """The checkout at ``folder``.

        Raises:
            OptionError: there is none.
        """
        if not (folder / "regrasp_gym" / "__init__.py").is_file():
            raise OptionError(f"--against {folder} is no checkout of regrasp-gym: it holds no folder regrasp_gym")
        python = folder.resolve() / ".venv" / "bin" / "python"
        return Checkout(folder.resolve(), str(python) if python.exists() else sys.executable)

    @contextmanager
    def server(self, env_id: str, cache: Path | None = None) -> Generator[PlanServer]:
        """A process that plans with this checkout, ended on the way out.

        Args:
            env_id: id of the environment.
            cache: folder of the compilation cache; None for the usual one.
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
    """This side of a process that runs `plan_server`."""

    def __init__(self, process: subprocess.Popen[str], began: float) -> None:
        self._process, self._began = process, began
        self.startup = self._answer()

    def plan(self, seed: int, strategy: str) -> Record:
        """Success, number of stages, and seconds of a plan, as a whole and by module."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"seed": seed, "strategy": strategy}) + "\n")
        self._process.stdin.flush()
        return self._answer()

    @property
    def age(self) -> float:
        """Seconds since the process was started."""
        return time.perf_counter() - self._began

    def _answer(self) -> Record:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise BrokenPipeError
        return json.loads(line)


def compare(trials: Sequence[Sequence[Record]]) -> Record:
    """Success counts, and median and 90 % quantile of the seconds, by checkout; and ratios where there are two.

    Args:
        trials: of each scene, one record per checkout.
    """
    if not trials:
        return {}
    names = list(trials[0][0]["seconds"])
    seconds = {
        name: np.array([[side["seconds"].get(name, 0.0) for side in sides] for sides in trials]) for name in names
    }
    figures: Record = {
        "success": [sum(side["success"] for side in sides) for sides in zip(*trials, strict=True)],
        "of": len(trials),
        "seconds_median": {name: np.median(each, axis=0) for name, each in seconds.items()},
        "seconds_p90": {name: np.quantile(each, 0.9, axis=0) for name, each in seconds.items()},
    }
    if len(trials[0]) == 2:
        for quantile in ("median", "p90"):
            both = figures[f"seconds_{quantile}"]
            figures[f"ratio_{quantile}"] = {name: float(a / b) if b else None for name, (a, b) in both.items()}
        pairs = seconds["plan"]
        figures["ratio_of_each_median"] = float(np.median(pairs[:, 0] / pairs[:, 1]))
    return figures


# --- trials -----------------------------------------------------------------------------------------------------------


def _checkouts(setting: Record) -> list[Checkout]:
    return [Checkout.this(), *(Checkout.other(Path(folder)) for folder in setting["checkouts"][1:])]


def _warm(setting: Record) -> Callable[[int], Record]:
    """Plans of one scene, by every checkout in turn; the first of each is not timed."""
    # Closed with the process: the servers outlive one trial.
    stack = ExitStack()
    servers = [stack.enter_context(checkout.server(setting["env"])) for checkout in _checkouts(setting)]

    def run(seed: int) -> Record:
        assert stack
        for server in servers:
            server.plan(seed, setting["strategy"])
        answers = [server.plan(seed, setting["strategy"]) for server in servers]
        for answer in answers:
            answer["seconds"] = {"plan": answer["seconds"], **answer.pop("modules")}
        return {"plans": answers}

    return run


def _first(setting: Record) -> Callable[[int], Record]:
    """First plans of fresh processes, one per checkout."""
    empty = setting["what"] == "empty cache"

    def run(trial: int) -> Record:
        del trial
        answers: list[Record] = []
        for checkout in _checkouts(setting):
            with tempfile.TemporaryDirectory() as folder:
                with checkout.server(setting["env"], Path(folder) if empty else None) as server:
                    first = server.plan(FIRST_PLAN_SEED, "repeated")
                    seconds = {"plan": server.age, **server.startup, "first plan": first["seconds"]}
                    seconds["same plan again"] = server.plan(FIRST_PLAN_SEED, "repeated")["seconds"]
                answers.append({"success": first["success"], "stages": first["stages"], "seconds": seconds})
        return {"plans": answers}

    return run


def _show(report: Record) -> None:
    console = Console()
    two = len(report["checkouts"]) == 2
    for scenario, figures in report["scenarios"].items():
        for what, row in figures.items():
            if not row:
                continue
            counts = " and ".join(f"{count} of {row['of']}" for count in row["success"])
            heads = ("median\n(s)", "90 %\n(s)", *(("other\n(s)", "90 %\n(s)", "ratio", "90 %") if two else ()))
            table = Table("seconds of", title=f"{scenario}: {what}, {counts} planned", title_justify="left")
            for head in heads:
                table.add_column(head, justify="right")
            for name in row["seconds_median"]:
                pairs = zip(row["seconds_median"][name], row["seconds_p90"][name], strict=True)
                cells = [f"{value:.2f}" for pair in pairs for value in pair]
                ratios = [row[f"ratio_{quantile}"][name] for quantile in ("median", "p90")] if two else []
                table.add_row(name, *cells, *("" if ratio is None else f"{ratio:.2f}" for ratio in ratios))
            console.print(table)
    for error, trials in report["crashed"].items():
        console.print(f"crashed: {error}, trials {trials}", style="red", markup=False, highlight=False)
