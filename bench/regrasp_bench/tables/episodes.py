"""How many scenes the expert plans, how many of those plans hold in the simulation, and why the others do not."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import gymnasium
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

import regrasp_gym
from regrasp_gym.reports.trials import Record, crashes, run_trials, write_report

if TYPE_CHECKING:
    from regrasp_gym.expert.expert import PlannerExpert
    from regrasp_planner import Phase


def episodes(
    env: str = "regrasp_gym/PandaYCB-v0",
    strategy: str = "repeated",
    first_seed: int = 0,
    count: int = 100,
    control_mode: str = "joint_pos",
    workers: int = 1,
    records: Path = Path("outputs/bench/episodes.jsonl"),
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> None:
    """Plan and execute one episode per seed; print planned and executed counts, and the failures by cause.

    Interrupted runs go on where they stopped: seeds that ``records`` holds already are not run again.

    Args:
        env: id of the environment.
        strategy: how far the planner may go.
        first_seed: first scene.
        count: number of scenes.
        control_mode: action space the expert acts through.
        workers: processes.
        records: one JSON line per episode, appended as they end.
        json_file: write the summary as JSON.
    """
    setting = {"env": env, "strategy": strategy, "control_mode": control_mode, "version": version("regrasp-gym")}
    seeds = range(first_seed, first_seed + count)
    ended = run_trials(setting, seeds, _prepare, workers=workers, records=records, label="episodes")
    summary = summarise(setting, ended)
    _show(summary)
    write_report(json_file, summary)


def run_episode(env: gymnasium.Env, expert: PlannerExpert, seed: int) -> Record:
    """Plan and execute one episode: what happened, as one JSON-able record."""
    record = plan_episode(env, expert, seed)
    return record | execute_episode(env, expert)


def plan_episode(env: gymnasium.Env, expert: PlannerExpert, seed: int) -> Record:
    """Reset the environment and plan: what came of it and what it cost."""
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
    """Let the expert act until it is done; nothing happens if it has no plan."""
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


def summarise(setting: Record, episodes: list[Record]) -> Record:
    """Counts, failures by cause, and times, of episodes in the order of their seeds."""
    ended = [record for record in episodes if "crashed" not in record]
    planned = [record for record in ended if record["planned"]]
    succeeded = [record for record in planned if record["success"]]
    # The first episodes of a process compile; the median does not see them.
    seconds = [record["planning_seconds"] for record in planned] or [float("nan")]
    return {
        **setting,
        "seeds": [episodes[0]["trial"], episodes[-1]["trial"]] if episodes else [],
        "episodes": len(episodes),
        "planned": len(planned),
        "planned_with_regrasp": sum(len(record["stages"]) > 1 for record in planned),
        "executed": len(succeeded),
        "executed_share": len(succeeded) / len(planned) if planned else 0.0,
        "planning_failures": _causes([record for record in ended if not record["planned"]]),
        "execution_failures": _causes([record for record in planned if not record["success"]]),
        "crashed": crashes(episodes),
        "failed_in_execution": [record["seed"] for record in planned if not record["success"]],
        "planning_seconds_median": float(np.median(seconds)),
        "planning_seconds_p90": float(np.quantile(seconds, 0.9)),
        "eval_grasp_calls_mean": float(np.mean([record["eval_grasp_calls"] for record in ended] or [0])),
    }


def _causes(failed: list[Record]) -> dict[str, int]:
    return dict(Counter(record["cause"] for record in failed).most_common())


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
    return f"{part / whole:.0%}" if whole else "–"
