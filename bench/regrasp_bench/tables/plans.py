"""What users wait for: warm plans, and the first plan of a process; also of another checkout, in turn."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from regrasp_bench.options import BenchOptions
from regrasp_bench.tables.benchmark import Presentation, publish
from regrasp_bench.tables.checkouts import Checkout
from regrasp_bench.tables.scenarios import ENVS, Scenario
from regrasp_gym.reports.report import Record
from regrasp_gym.reports.trials import Prepare, crashes, print_crashes, run_trials

FIRST_PLAN_SEED = 2
"""Scene of the first plan of a process: one with a regrasp."""


@dataclass(frozen=True, kw_only=True)
class PlansOptions(BenchOptions):
    """Time warm plans by strategy and module, and the first plan of a process with a filled and an empty cache.

    Every plan is made by a process of its checkout. With AGAINST, both checkouts plan each scene in turn, so that a
    noisy machine affects both alike, and ratios are printed: this checkout over the other.
    """

    scenarios: tuple[Scenario, ...] = get_args(Scenario)
    """Scenarios."""
    strategies: tuple[str, ...] = ("repeated",)
    """Strategies of the warm plans."""
    scenes: int = 50
    """Number of scenes, planned with each strategy, once untimed and once timed."""
    first_seed: int = 0
    """Seed of the first scene."""
    starts: int = 3
    """Number of processes whose first plan is timed with a filled cache."""
    empty_starts: int = 1
    """Number of processes with an empty cache; each compiles everything."""
    against: Path | None = None
    """Root of another checkout. Its .venv/bin/python runs it, or this interpreter if it has none."""
    workers: tyro.conf.Suppress[tyro.conf.Fixed[int]] = 1
    records: Path = Path("outputs/bench/plans.jsonl")
    """One JSON line per scene or start, appended as it ends."""


def plans(options: PlansOptions) -> int:
    """Run the benchmark; returns the exit code.

    Raises:
        OptionError: ``against`` is not a checkout.
    """
    checkouts = [Checkout.this()] if options.against is None else [Checkout.this(), Checkout.other(options.against)]
    folders = [str(checkout.folder) for checkout in checkouts]
    ended: list[Record] = []

    def run(setting: Record, trials: Sequence[int], prepare: Prepare, label: str) -> Record:
        records = run_trials(setting, trials, prepare, workers=1, records=options.records, label=label)
        ended.extend(records)
        return compare([trial["plans"] for trial in records if "plans" in trial])

    seeds = range(options.first_seed, options.first_seed + options.scenes)
    report: Record = {"checkouts": folders, "scenarios": {}}
    for scenario in options.scenarios:
        shared: Record = {"checkouts": folders, "env": ENVS[scenario]}
        figures: Record = {}
        for strategy in options.strategies:
            setting = {**shared, "what": "warm", "strategy": strategy}
            figures[f"warm, {strategy}"] = run(setting, seeds, _warm, f"{scenario}, {strategy}")
        for what, count in (("filled cache", options.starts), ("empty cache", options.empty_starts)):
            name = f"first plan, {what}"
            figures[name] = run({**shared, "what": what}, range(count), _first, f"{scenario}, {name}")
        report["scenarios"][scenario] = figures
    report["crashed"] = crashes(ended)
    publish(options, report, ended, Presentation(_show))
    return 1 if report["crashed"] else 0


def compare(trials: Sequence[Sequence[Record]]) -> Record:
    """Successes, medians and 90 % quantiles of times by checkout, and ratios if there are two checkouts.

    Args:
        trials: one record per checkout, for each scene.
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
    """Plans of a scene by every checkout in turn; the first of each is not timed."""
    # Closed with the process: the servers outlive a trial.
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
    print_crashes(report["crashed"], "trials")
