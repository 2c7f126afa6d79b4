"""Tables III and IV of the paper: what each strategy plans and what of it holds, and what the planning costs."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import gymnasium
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

import regrasp_gym
from regrasp_bench.tables.episodes import execute_episode, plan_episode
from regrasp_gym.errors import BenchError
from regrasp_gym.reports.plots import OURS, OURS_TOO, PAPER, bars, check_format, draw
from regrasp_gym.reports.trials import Record, crashes, read_records, run_trials, wilson, write_report

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from regrasp_planner import Plan

Scenario = Literal["panda", "excavator"]
Strategy = Literal["sampling", "direct", "static", "nonstatic", "repeated"]
STRATEGIES: tuple[Strategy, ...] = ("sampling", "direct", "static", "nonstatic", "repeated")
ENVS: dict[Scenario, str] = {"panda": "regrasp_gym/PandaYCB-v0", "excavator": "regrasp_gym/ExcavatorStones-v0"}

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

_RECORDS = Path("outputs/bench/table3.jsonl")
_Json = Annotated[Path | None, tyro.conf.arg(name="json")]
_Plot = Annotated[Path | None, tyro.conf.arg(name="plot")]


def table3(
    scenario: Scenario = "panda",
    trials: int = 300,
    first_seed: int = 0,
    strategies: tuple[Strategy, ...] = STRATEGIES,
    execute: bool = True,
    workers: int = 1,
    records: Path = _RECORDS,
    json_file: _Json = None,
    plot_file: _Plot = None,
) -> None:
    """Success of each strategy over the same scenes, planned and executed (Table III of the paper).

    An interrupted run goes on where it stopped, scene by scene and strategy by strategy.

    Args:
        scenario: robot and objects.
        trials: scenes, one per seed.
        first_seed: seed of the first scene.
        strategies: how far the planner may go; one row each.
        execute: execute the plans in the simulation too.
        workers: processes.
        records: one JSON line per scene and strategy, appended as they end.
        json_file: write the summary as JSON.
        plot_file: draw the counts beside the paper's (.svg, .png or .pdf).
    """
    check_format(plot_file)
    report = _campaign(scenario, trials, first_seed, strategies, execute, workers, records)
    _show_successes(report)
    write_report(json_file, report)
    draw(plot_file, partial(_paint_successes, report))


def table4(
    scenario: Scenario = "panda",
    trials: int = 300,
    first_seed: int = 0,
    strategies: tuple[Strategy, ...] = STRATEGIES,
    execute: bool = True,
    workers: int = 1,
    records: Path = _RECORDS,
    json_file: _Json = None,
    plot_file: _Plot = None,
) -> None:
    """Mean number of evaluated grasps of each strategy (Table IV of the paper), from the records of ``table3``.

    Args:
        scenario: robot and objects.
        trials: scenes, one per seed.
        first_seed: seed of the first scene.
        strategies: how far the planner may go; one row each.
        execute: as in ``table3``: trials with and without execution are different records.
        workers: processes, for scenes that are not in the records.
        records: those of ``table3``.
        json_file: write the summary as JSON.
        plot_file: draw the means beside the paper's (.svg, .png or .pdf).
    """
    check_format(plot_file)
    report = _campaign(scenario, trials, first_seed, strategies, execute, workers, records)
    _show_calls(report)
    write_report(json_file, report)
    draw(plot_file, partial(_paint_calls, report))


def summarise(scenario: Scenario, strategy: Strategy, episodes: Sequence[Record], execute: bool) -> Record:
    """One row of both tables, from the records of one strategy."""
    ended = [record for record in episodes if "crashed" not in record]
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
            "median": float(np.median(seconds)),
            "p90": float(np.quantile(seconds, 0.9)),
            "median_of_planned": float(np.median([r["planning_seconds"] for r in planned] or [np.nan])),
        },
        "planning_failures": _causes([record for record in ended if not record["planned"]]),
        "crashed": crashes(episodes),
    }
    if execute:
        succeeded = [record for record in planned if record["success"]]
        failed = [record for record in planned if not record["success"]]
        summary |= {
            "executed": len(succeeded),
            "executed_share_95": wilson(len(succeeded), len(planned)),
            "taken_over": sum(bool(record["taken_over_from"]) for record in ended),
            "execution_failures": _causes(failed),
            "failed_in_execution": [record["trial"] for record in failed],
        }
    return summary


def fingerprint(plan: Plan) -> str:
    """Digest of all that a plan makes the robot do: equal for plans that are executed alike."""
    digest = hashlib.sha256()
    for stage in plan.stages:
        digest.update(stage.kind.encode())
        for pose in (stage.grasp.pose, stage.start_pose, stage.release_pose, stage.settled_pose):
            digest.update(np.asarray(pose, float).tobytes())
        digest.update(np.array([stage.grasp.theta, stage.grasp.opening], float).tobytes())
        for segment in stage.segments:
            digest.update(f"{segment.kind} {segment.holding} {segment.theta!r}".encode())
            if segment.trajectory is not None:
                for array in (segment.trajectory.times, segment.trajectory.positions, segment.trajectory.velocities):
                    digest.update(np.ascontiguousarray(array, float).tobytes())
    return digest.hexdigest()


# --- trials -----------------------------------------------------------------------------------------------------------


def _campaign(
    scenario: Scenario,
    trials: int,
    first_seed: int,
    strategies: Sequence[Strategy],
    execute: bool,
    workers: int,
    records: Path,
) -> Record:
    env = ENVS[scenario]
    if env not in gymnasium.registry:
        there = ", ".join(name for name, made in ENVS.items() if made in gymnasium.registry)
        raise BenchError(f"scenario {scenario!r} needs the environment {env}, which is not there yet; use {there}")
    seeds = range(first_seed, first_seed + trials)
    rows: list[Record] = []
    # The most far-reaching one first: what it came to on the way is what the others come to.
    for strategy in sorted(set(strategies), key=STRATEGIES.index, reverse=True):
        setting: Record = {"env": env, "strategy": strategy, "execute": execute, "version": version("regrasp-gym")}
        prepare = partial(_prepare, records)
        episodes = run_trials(setting, seeds, prepare, workers=workers, records=records, label=strategy)
        rows.insert(0, summarise(scenario, strategy, episodes, execute))
    return {
        "scenario": scenario,
        "env": env,
        "seeds": [seeds.start, seeds.stop - 1],
        "execute": execute,
        "strategies": rows,
    }


def _prepare(records: Path, setting: Record) -> Callable[[int], Record]:
    from regrasp_planner import Strategy as Known

    if setting["strategy"] not in list(Known):
        known = ", ".join(str(member) for member in Known)
        raise BenchError(f"the planner has no strategy {setting['strategy']!r}; it has {known}")
    env = gymnasium.make(setting["env"])
    expert = regrasp_gym.PlannerExpert(env, setting["strategy"])
    others = _of_other_strategies(read_records(records), setting)

    def run(seed: int) -> Record:
        part = next((part for whole in others if whole["trial"] == seed and (part := _part_of(whole, setting))), None)
        if part is not None:
            return part
        record = plan_episode(env, expert, seed)
        if not (setting["execute"] and record["planned"]):
            return record | {"taken_over_from": ""}
        record["fingerprint"] = fingerprint(expert.plan)
        for other in others:
            if other["trial"] == seed and other.get("fingerprint") == record["fingerprint"] and _as_planned(other):
                same = {key: other[key] for key in ("success", "steps", "plans", "cause", "detail")}
                return record | same | {"taken_over_from": other["setting"]["strategy"]}
        return record | execute_episode(env, expert) | {"taken_over_from": ""}

    return run


def _of_other_strategies(records: Sequence[Record], setting: Record) -> list[Record]:
    """Records of the same campaign by other strategies."""
    common = {key: value for key, value in setting.items() if key != "strategy"}
    return [
        record
        for record in records
        if "crashed" not in record
        and record["setting"]["strategy"] != setting["strategy"]
        and common == {key: value for key, value in record["setting"].items() if key != "strategy"}
    ]


def _as_planned(record: Record) -> bool:
    """Whether a plan was carried out without a hitch.

    One plan is made before the first stage and one after each but the last. An episode with more has seen something go
    wrong, and what was planned then depends on the strategy.
    """
    return bool(record.get("success")) and record["plans"] == len(record["stages"])


def _part_of(whole: Record, setting: Record) -> Record | None:
    """What a strategy comes to in a trial of one that contains it: both plan alike, as far as the lesser one goes.

    None where that can not be told from the record.
    """
    order = [phase["strategy"] for phase in whole["phases"]]
    asked, contains = setting["strategy"], STRATEGIES.index(whole["setting"]["strategy"])
    if "sampling" in (asked, *order) or STRATEGIES.index(asked) > contains:
        return None
    # The plan may have been found by a still lesser strategy.
    phase = whole["phases"][order.index(asked)] if asked in order else whole["phases"][-1]
    if phase["planned"] and setting["execute"] and not _as_planned(whole):
        return None
    outcome = {key: phase[key] for key in ("planned", "planning_seconds", "eval_grasp_calls", "ordered_starts")}
    if phase["planned"]:
        own = {key: value for key, value in whole.items() if key not in ("setting", "trial")}
        return own | outcome | {"taken_over_from": whole["setting"]["strategy"]}
    kept = {key: whole[key] for key in ("seed", "target", "phases")}
    reason = {"stages": [], "seconds": {}, "cause": phase["cause"], "detail": phase["detail"]}
    return kept | outcome | reason | {"taken_over_from": whole["setting"]["strategy"]}


def _causes(failed: Sequence[Record]) -> dict[str, int]:
    return dict(Counter(record["cause"] for record in failed).most_common())


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
            _share(row["planned"], row["trials"], row["planned_share_95"]),
            f"{paper['planned']}/{paper['trials']}",
            str(row["executed"]) if report["execute"] else "–",
            _share(row["executed"], row["planned"], row["executed_share_95"]) if report["execute"] else "–",
            f"{seconds['median']:.2f}",
            f"{seconds['p90']:.2f}",
        )
    console.print(table)
    console.print("done: executed with success, of those planned; s: planning time, median and 90 %", highlight=False)
    for row in report["strategies"]:
        for kind, causes in (("no plan", row["planning_failures"]), ("lost", row.get("execution_failures", {}))):
            listed = ", ".join(f"{number} {cause}" for cause, number in causes.items())
            if listed:
                console.print(f"{row['strategy']}, {kind}: {listed}", highlight=False)
        if row.get("failed_in_execution"):
            console.print(f"{row['strategy']}, seeds lost: {row['failed_in_execution']}", highlight=False)
        for error, seeds in row["crashed"].items():
            message = f"{row['strategy']}, crashed: {error}, seeds {seeds}"
            console.print(message, style="red", markup=False, highlight=False)


def _show_calls(report: Record) -> None:
    title = f"Table IV, {report['scenario']}, seeds {report['seeds'][0]}–{report['seeds'][1]}"
    table = Table("strategy", "trials", "eval-grasp calls, mean", "paper", "starts ordered, mean", title=title)
    for row in report["strategies"]:
        paper = row["paper_eval_grasp_calls"]
        calls, ordered = (f"{row[name]:.0f}" for name in ("eval_grasp_calls_mean", "ordered_starts_mean"))
        table.add_row(row["strategy"], str(row["trials"]), calls, "–" if paper is None else str(paper), ordered)
    console = Console()
    console.print(table)
    console.print("starts ordered: put in order by bounding boxes, none of them evaluated by that", highlight=False)


def _share(part: int, whole: int, interval: tuple[float, float]) -> str:
    return f"{100 * part / whole:.0f} ({100 * interval[0]:.0f}–{100 * interval[1]:.0f})" if whole else "–"


def _paint_successes(report: Record, axes: Axes) -> None:
    rows = report["strategies"]
    series: dict[str, list[float | None]] = {"planned": [_percent(row["planned"], row["trials"]) for row in rows]}
    spans = {"planned": [_percents(row["planned_share_95"]) for row in rows]}
    if report["execute"]:
        series["planned and executed"] = [_percent(row["executed"], row["trials"]) for row in rows]
    series["paper"] = [_percent(row["paper"]["planned"], row["paper"]["trials"]) for row in rows]
    colours = (OURS, OURS_TOO, PAPER) if report["execute"] else (OURS, PAPER)
    bars(axes, [row["strategy"] for row in rows], series, colours, spans)
    axes.set_ylabel("success (%)")
    axes.set_ylim(0, 118)
    axes.set_title(f"{report['scenario']}: {rows[0]['trials'] if rows else 0} scenes")


def _paint_calls(report: Record, axes: Axes) -> None:
    rows = report["strategies"]
    series = {
        "mean eval-grasp calls": [row["eval_grasp_calls_mean"] for row in rows],
        "paper": [row["paper_eval_grasp_calls"] for row in rows],
    }
    bars(axes, [row["strategy"] for row in rows], series, (OURS, PAPER))
    axes.set_yscale("log")
    axes.set_ylabel("evaluated grasps per trial")
    axes.set_title(report["scenario"])


def _percent(part: int, whole: int) -> float | None:
    return round(100 * part / whole, 1) if whole else None


def _percents(interval: tuple[float, float]) -> tuple[float, float]:
    return 100 * interval[0], 100 * interval[1]
