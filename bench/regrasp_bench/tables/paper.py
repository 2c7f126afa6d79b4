"""Tables III and IV of the paper: what each strategy plans, how many plans hold, and what planning costs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.table import Table

from regrasp_bench.tables.benchmark import Presentation, check_plot, publish
from regrasp_bench.tables.scenarios import Scenario, ScenarioOptions
from regrasp_bench.tables.strategies import STRATEGIES, Strategy, prepare
from regrasp_bench.tables.summary import NOTHING, causes, completed, median_and_p90, percent
from regrasp_gym.reports.plots import OURS, OURS_LIGHT, PAPER, bars
from regrasp_gym.reports.report import Record, wilson
from regrasp_gym.reports.trials import crashes, print_crashes, run_trials

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PAPER_TRIALS = 300
PAPER_SUCCESSES: dict[Scenario, tuple[int, ...]] = {
    "panda": (75, 120, 170, 201, 224),
    "excavator": (43, 103, 209, 263, 288),
}
"""Successful trials of 300 by strategy (Song et al., Table III)."""
PAPER_CALLS: dict[Scenario, tuple[int | None, ...]] = {
    "panda": (None, 44, 247, 341, 379),
    "excavator": (None, 63, 570, 918, 1389),
}
"""Mean eval-grasp calls per trial by strategy (Song et al., Table IV)."""


@dataclass(frozen=True, kw_only=True)
class StrategyOptions(ScenarioOptions):
    """Options of both tables. They share their records."""

    strategies: tuple[Strategy, ...] = STRATEGIES
    """Strategies of the planner; one row each."""
    execute: bool = True
    """Also execute the plans in the simulation. Records with and without execution are different."""
    records: Path = Path("outputs/bench/table3.jsonl")
    """One JSON line per scene and strategy, appended as it ends."""


@dataclass(frozen=True, kw_only=True)
class Table3Options(StrategyOptions):
    """Success of each strategy over the same scenes, planned and executed (Table III of the paper).

    An interrupted run resumes, scene by scene and strategy by strategy.
    """


@dataclass(frozen=True, kw_only=True)
class Table4Options(StrategyOptions):
    """Mean number of evaluated grasps of each strategy (Table IV of the paper), from the records of ``table3``.

    Scenes that the records lack are run.
    """


def table3(options: Table3Options) -> int:
    """Run what the records lack, and publish Table III; returns the exit code."""
    return _publish(options, Presentation(_show_successes, _paint_successes))


def table4(options: Table4Options) -> int:
    """Run what the records lack, and publish Table IV; returns the exit code."""
    return _publish(options, Presentation(_show_calls, _paint_calls))


def _publish(options: StrategyOptions, presentation: Presentation) -> int:
    check_plot(options)
    env, seeds = options.env, options.seeds
    rows: list[Record] = []
    # The most capable strategy first: its trials tell the outcome of most trials of the others.
    for strategy in sorted(set(options.strategies), key=STRATEGIES.index, reverse=True):
        setting = {"env": env, "strategy": strategy, "execute": options.execute, "version": version("regrasp-gym")}
        episodes = run_trials(
            setting,
            seeds,
            partial(prepare, options.records),
            workers=options.workers,
            records=options.records,
            label=strategy,
        )
        rows.insert(0, summarise(options.scenario, strategy, episodes, options.execute))
    summary: Record = {
        "scenario": options.scenario,
        "env": env,
        "seeds": [seeds.start, seeds.stop - 1],
        "execute": options.execute,
        "strategies": rows,
    }
    publish(options, summary, (), presentation)
    return 1 if any(row["crashed"] for row in rows) else 0


def summarise(scenario: Scenario, strategy: Strategy, episodes: Sequence[Record], execute: bool) -> Record:
    """One row of both tables, from the records of one strategy."""
    ended = completed(episodes)
    planned = [record for record in ended if record["planned"]]
    seconds = [record["planning_seconds"] for record in ended] or [float("nan")]
    row = STRATEGIES.index(strategy)
    summary: Record = {
        "strategy": strategy,
        "trials": len(episodes),
        "planned": len(planned),
        "planned_share_95": wilson(len(planned), len(episodes)),
        "paper": {"planned": PAPER_SUCCESSES[scenario][row], "trials": PAPER_TRIALS},
        "stages": dict(sorted(Counter(len(record["stages"]) for record in planned).items())),
        "eval_grasp_calls_mean": float(np.mean([record["eval_grasp_calls"] for record in ended] or [np.nan])),
        "ordered_starts_mean": float(np.mean([record["ordered_starts"] for record in ended] or [np.nan])),
        "paper_eval_grasp_calls": PAPER_CALLS[scenario][row],
        "planning_seconds": {
            **median_and_p90(seconds),
            "median_of_planned": float(np.median([r["planning_seconds"] for r in planned] or [np.nan])),
        },
        "planning_failures": causes([record for record in ended if not record["planned"]]),
        "crashed": crashes(episodes),
    }
    if execute:
        succeeded = [record for record in planned if record["success"]]
        failed = [record for record in planned if not record["success"]]
        summary |= {
            "executed": len(succeeded),
            "executed_share_95": wilson(len(succeeded), len(planned)),
            "taken_over": sum(bool(record["taken_over_from"]) for record in ended),
            "execution_failures": causes(failed),
            "failed_in_execution": [record["trial"] for record in failed],
        }
    return summary


# --- what is shown ----------------------------------------------------------------------------------------------------


def _show_successes(report: Record) -> None:
    title = f"Table III, {report['scenario']}, seeds {report['seeds'][0]}–{report['seeds'][1]}"
    table = Table("strategy", "planned", "% (95 %)", "paper", "done", "% (95 %)", "s", "p90", title=title)
    console = Console()
    for row in report["strategies"]:
        paper, seconds = row["paper"], row["planning_seconds"]
        table.add_row(
            row["strategy"],
            f"{row['planned']}/{row['trials']}",
            percent(row["planned"], row["trials"], row["planned_share_95"]),
            f"{paper['planned']}/{paper['trials']}",
            str(row["executed"]) if report["execute"] else NOTHING,
            percent(row["executed"], row["planned"], row["executed_share_95"]) if report["execute"] else NOTHING,
            f"{seconds['median']:.2f}",
            f"{seconds['p90']:.2f}",
        )
    console.print(table)
    console.print("done: executed with success, of those planned; s: planning time, median and 90 %", highlight=False)
    for row in report["strategies"]:
        for kind, failures in (("no plan", row["planning_failures"]), ("lost", row.get("execution_failures", {}))):
            listed = ", ".join(f"{number} {cause}" for cause, number in failures.items())
            if listed:
                console.print(f"{row['strategy']}, {kind}: {listed}", highlight=False)
        if row.get("failed_in_execution"):
            console.print(f"{row['strategy']}, seeds lost: {row['failed_in_execution']}", highlight=False)
        print_crashes(row["crashed"], prefix=f"{row['strategy']}, ")


def _show_calls(report: Record) -> None:
    title = f"Table IV, {report['scenario']}, seeds {report['seeds'][0]}–{report['seeds'][1]}"
    table = Table("strategy", "trials", "eval-grasp calls, mean", "paper", "starts ordered, mean", title=title)
    for row in report["strategies"]:
        paper = row["paper_eval_grasp_calls"]
        calls, ordered = (f"{row[name]:.0f}" for name in ("eval_grasp_calls_mean", "ordered_starts_mean"))
        table.add_row(row["strategy"], str(row["trials"]), calls, NOTHING if paper is None else str(paper), ordered)
    console = Console()
    console.print(table)
    console.print("starts ordered: sorted by bounding boxes, which evaluates none of them", highlight=False)


def _paint_successes(report: Record, _: Sequence[Record], axes: Axes) -> None:
    rows = report["strategies"]
    series: dict[str, list[float | None]] = {"planned": [_in_percent(row["planned"], row["trials"]) for row in rows]}
    spans = {"planned": [_percents(row["planned_share_95"]) for row in rows]}
    if report["execute"]:
        series["planned and executed"] = [_in_percent(row["executed"], row["trials"]) for row in rows]
    series["paper"] = [_in_percent(row["paper"]["planned"], row["paper"]["trials"]) for row in rows]
    colours = (OURS, OURS_LIGHT, PAPER) if report["execute"] else (OURS, PAPER)
    bars(axes, [row["strategy"] for row in rows], series, colours, spans)
    axes.set_ylabel("success (%)")
    axes.set_ylim(0, 118)
    axes.set_title(f"{report['scenario']}: {rows[0]['trials'] if rows else 0} scenes")


def _paint_calls(report: Record, _: Sequence[Record], axes: Axes) -> None:
    rows = report["strategies"]
    series = {
        "mean eval-grasp calls": [row["eval_grasp_calls_mean"] for row in rows],
        "paper": [row["paper_eval_grasp_calls"] for row in rows],
    }
    bars(axes, [row["strategy"] for row in rows], series, (OURS, PAPER))
    axes.set_yscale("log")
    axes.set_ylabel("evaluated grasps per trial")
    axes.set_title(report["scenario"])


def _in_percent(part: int, whole: int) -> float | None:
    return round(100 * part / whole, 1) if whole else None


def _percents(interval: tuple[float, float]) -> tuple[float, float]:
    return 100 * interval[0], 100 * interval[1]
