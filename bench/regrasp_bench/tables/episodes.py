"""How many scenes the expert plans, how many of its plans hold in the simulation, and why the others fail."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import gymnasium
import numpy as np
from rich.console import Console
from rich.table import Table

import regrasp_gym
from regrasp_bench.options import BenchOptions
from regrasp_bench.tables.benchmark import Presentation, run_benchmark
from regrasp_bench.tables.summary import NOTHING, causes, completed, median_and_p90, seed_range
from regrasp_gym.reports.report import Record
from regrasp_gym.reports.trials import crashes

if TYPE_CHECKING:
    from regrasp_gym.expert.expert import PlannerExpert
    from regrasp_planner import Phase


@dataclass(frozen=True, kw_only=True)
class EpisodesOptions(BenchOptions):
    """Plan and execute one episode per seed; print the planned and executed counts, and the failures by cause.

    An interrupted run resumes: seeds that the records hold are not run again.
    """

    env: str = "regrasp_gym/PandaYCB-v0"
    """Environment id."""
    strategy: str = "repeated"
    """Strategy of the planner."""
    first_seed: int = 0
    """Seed of the first scene."""
    count: int = 100
    """Number of scenes."""
    control_mode: str = "joint_pos"
    """Action space through which the expert acts."""
    records: Path = Path("outputs/bench/episodes.jsonl")


def episodes(options: EpisodesOptions) -> int:
    """Run the benchmark; returns the exit code."""
    setting = options.values("env", "strategy", "control_mode")
    setting["version"] = version("regrasp-gym")
    seeds = range(options.first_seed, options.first_seed + options.count)
    return run_benchmark(options, setting, seeds, _prepare, summarise, Presentation(_show), "episodes")


def run_episode(env: gymnasium.Env, expert: PlannerExpert, seed: int) -> Record:
    """Plan and execute one episode; its record."""
    record = plan_episode(env, expert, seed)
    return record | execute_episode(env, expert)


def plan_episode(env: gymnasium.Env, expert: PlannerExpert, seed: int) -> Record:
    """Reset the environment and plan; outcome and cost as a record."""
    env.reset(seed=seed)
    began = time.perf_counter()
    planned = expert.reset()
    return {
        "seed": seed,
        "target": expert.env.scene.target.name,
        "planned": planned,
        "stages": [str(stage.kind) for stage in expert.plan.stages],
        "planning_seconds": time.perf_counter() - began,
        "seconds": expert.plan.stats.seconds,
        "eval_grasp_calls": expert.plan.stats.eval_grasp_calls,
        "ordered_starts": expert.plan.stats.ordered_starts,
        "phases": [_phase(phase) for phase in expert.plan.stats.phases],
        "cause": "" if expert.failure is None else str(expert.failure.reason),
        "detail": str(expert.failure or ""),
    }


def _phase(phase: Phase) -> Record:
    return {
        "strategy": str(phase.strategy),
        "planned": phase.failure is None,
        "planning_seconds": phase.seconds,
        "eval_grasp_calls": phase.eval_grasp_calls,
        "ordered_starts": phase.ordered_starts,
        "cause": "" if phase.failure is None else str(phase.failure.reason),
        "detail": str(phase.failure or ""),
    }


def execute_episode(env: gymnasium.Env, expert: PlannerExpert) -> Record:
    """Let the expert act until it is done; outcome as a record. Without a plan it does nothing."""
    steps = 0
    while (action := expert.act()) is not None:
        _, _, _, truncated, _ = env.step(action)
        steps += 1
        if truncated:
            break
    success, failure = expert.env.is_success, expert.failure
    record: Record = {"success": success, "steps": steps, "plans": len(expert.plans), "cause": "", "detail": ""}
    if not success:
        record["cause"] = str(failure.reason) if failure else "time limit"
        record["detail"] = str(failure or "")
    return record


def summarise(setting: Record, episodes: Sequence[Record]) -> Record:
    """Counts, failures by cause, and times of episodes in the order of their seeds."""
    ended = completed(episodes)
    planned = [record for record in ended if record["planned"]]
    succeeded = [record for record in planned if record["success"]]
    # The first episodes of a process compile, which hardly changes the median.
    seconds = [record["planning_seconds"] for record in planned] or [float("nan")]
    return {
        **setting,
        "seeds": seed_range(episodes),
        "episodes": len(episodes),
        "planned": len(planned),
        "planned_with_regrasp": sum(len(record["stages"]) > 1 for record in planned),
        "executed": len(succeeded),
        "executed_share": len(succeeded) / len(planned) if planned else 0.0,
        "planning_failures": causes([record for record in ended if not record["planned"]]),
        "execution_failures": causes([record for record in planned if not record["success"]]),
        "crashed": crashes(episodes),
        "failed_in_execution": [record["seed"] for record in planned if not record["success"]],
        **median_and_p90(seconds, "planning_seconds_"),
        "eval_grasp_calls_mean": float(np.mean([record["eval_grasp_calls"] for record in ended] or [0])),
    }


def _prepare(setting: Record) -> Callable[[int], Record]:
    env = gymnasium.make(setting["env"], control_mode=setting["control_mode"])
    expert = regrasp_gym.PlannerExpert(env, setting["strategy"])
    return partial(run_episode, env, expert)


def _show(summary: Record) -> None:
    console = Console()
    table = Table("", "count", "share", title=f"{summary['env']}, {summary['strategy']}, seeds {summary['seeds']}")
    total, planned = summary["episodes"], summary["planned"]
    table.add_row("episodes", str(total), "")
    table.add_row("planned", str(planned), _share(planned, total))
    table.add_row("  of these with a regrasp", str(summary["planned_with_regrasp"]), "")
    table.add_row(
        "plans that succeed in the simulation", str(summary["executed"]), _share(summary["executed"], planned)
    )
    for kind in ("planning", "execution"):
        for cause, number in summary[f"{kind}_failures"].items():
            table.add_row(f"{kind} failed: {cause}", str(number), _share(number, total))
    for error, seeds in summary["crashed"].items():
        table.add_row(f"crashed: {error}", str(len(seeds)), _share(len(seeds), total))
    console.print(table)
    median, p90 = summary["planning_seconds_median"], summary["planning_seconds_p90"]
    console.print(
        f"planning: median {median:.2f} s, 90 % within {p90:.2f} s; "
        f"{summary['eval_grasp_calls_mean']:.0f} evaluated grasps on average",
        highlight=False,
    )
    if summary["failed_in_execution"]:
        console.print(f"seeds that failed in execution: {summary['failed_in_execution']}", highlight=False)


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.0%}" if whole else NOTHING
