"""How often one grasp suffices, by the oracle, and how many of those scenes the planner's direct strategy solves."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import gymnasium
from rich.console import Console
from rich.table import Table

import regrasp_gym
from regrasp_bench.oracle.oracle import GraspUse, Oracle
from regrasp_bench.tables.benchmark import Presentation, check_plot, publish
from regrasp_bench.tables.episodes import plan_episode
from regrasp_bench.tables.scenarios import Scenario, ScenarioOptions
from regrasp_bench.tables.summary import completed, percent
from regrasp_gym.envs.base import RegraspEnv
from regrasp_gym.reports.plots import OURS, OURS_LIGHT, bars
from regrasp_gym.reports.report import Record, wilson
from regrasp_gym.reports.trials import crashes, print_crashes, run_trials

if TYPE_CHECKING:
    from matplotlib.axes import Axes

QUESTIONS = {"pick": "taken at all", "goal": "placed at all", "both": "one grasp suffices"}
"""Questions to the oracle, by the name in its verdict."""
TARGET_SHARES: dict[Scenario, tuple[float, float]] = {"panda": (0.39, 0.45), "excavator": (0.33, 0.39)}
"""Range of the share of scenes in which one grasp should suffice."""
_PACKAGES = ("regrasp-gym", "coal", "jax", "numpy", "scipy")


@dataclass(frozen=True, kw_only=True)
class DifficultyOptions(ScenarioOptions):
    """In how many scenes one grasp suffices, by an exhaustive search that is independent of the planner."""

    direct: bool = False
    """Also plan every scene with the strategy ``direct``, and compare."""
    records: Path = Path("outputs/bench/difficulty.jsonl")
    """One JSON line per scene, appended as it ends."""


def difficulty(options: DifficultyOptions) -> int:
    """Run the benchmark; returns the exit code."""
    check_plot(options)
    env, seeds = options.env, options.seeds
    run = partial(run_trials, trials=seeds, workers=options.workers, records=options.records)
    setting: Record = {"benchmark": "difficulty", "env": env, "config": _config(env), "version": version("regrasp-gym")}
    judged = run(setting, prepare=_prepare_oracle, label="oracle")
    summary: Record = {
        "scenario": options.scenario,
        "env": env,
        "seeds": [seeds.start, seeds.stop - 1],
        **summarise(judged),
    }
    if options.direct:
        planned = run(setting | {"strategy": "direct"}, prepare=_prepare_direct, label="direct")
        summary["direct"] = compare(judged, planned)
    publish(options, summary, judged, Presentation(_show, _paint, packages=_PACKAGES))
    return 1 if summary["crashed"] or summary.get("direct", {}).get("crashed") else 0


def summarise(judged: Sequence[Record]) -> Record:
    """Shares over all scenes and by target, from the oracle's records."""
    ended = completed(judged)
    by_target: defaultdict[str, list[Record]] = defaultdict(list)
    for record in ended:
        by_target[record["target"]].append(record)
    return {
        "trials": len(judged),
        "shares": {name: _share(ended, name, GraspUse.MOVABLE) for name in QUESTIONS},
        "shares_without_straight_lines": {name: _share(ended, name, GraspUse.REACHABLE) for name in QUESTIONS},
        "no_common_grasp": sum(record["common_grasps"] == 0 for record in ended),
        "one_grasp_seeds": [record["trial"] for record in ended if record["both"] == GraspUse.MOVABLE],
        "targets": {
            target: {"trials": len(some), **{name: _share(some, name, GraspUse.MOVABLE)["count"] for name in QUESTIONS}}
            for target, some in sorted(by_target.items())
        },
        "crashed": crashes(judged),
    }


def compare(judged: Sequence[Record], planned: Sequence[Record]) -> Record:
    """Successes of the direct strategy where the oracle says that one grasp suffices, and where it says otherwise."""
    verdicts = {record["trial"]: record["both"] for record in completed(judged)}
    found = {record["trial"] for record in planned if record.get("planned") and record["trial"] in verdicts}
    suffices = {seed for seed, both in verdicts.items() if both == GraspUse.MOVABLE}
    return {
        "planned": len(found),
        "planned_share_95": wilson(len(found), len(verdicts)),
        "of_one_grasp_seeds": len(found & suffices),
        "of_one_grasp_seeds_share_95": wilson(len(found & suffices), len(suffices)),
        "missed_by_direct": sorted(suffices - found),
        "missed_by_oracle": sorted(found - suffices),
        "crashed": crashes(planned),
    }


def _share(records: Sequence[Record], name: str, least: GraspUse) -> Record:
    count = sum(record[name] >= least for record in records)
    return {"count": count, "trials": len(records), "share_95": wilson(count, len(records))}


# --- trials -----------------------------------------------------------------------------------------------------------


def _config(env: str) -> str:
    """The scenes' configuration as text, which distinguishes records of other scenes."""
    made = gymnasium.make(env)
    world = made.unwrapped
    assert isinstance(world, RegraspEnv)
    config = str(world.scene_config)
    made.close()
    return config


def _prepare_oracle(setting: Record) -> Callable[[int], Record]:
    env = gymnasium.make(setting["env"])
    world = env.unwrapped
    assert isinstance(world, RegraspEnv)
    oracle = Oracle(world.planner_robot)

    def run(seed: int) -> Record:
        env.reset(seed=seed)
        task = world.task()
        return {"target": task.target.name, **oracle.judge(task)._asdict()}

    return run


def _prepare_direct(setting: Record) -> Callable[[int], Record]:
    env = gymnasium.make(setting["env"])
    expert = regrasp_gym.PlannerExpert(env, setting["strategy"])
    return lambda seed: plan_episode(env, expert, seed)


# --- what is shown ----------------------------------------------------------------------------------------------------


def _show(report: Record) -> None:
    console = Console()
    low, high = TARGET_SHARES[report["scenario"]]
    first, last = report["seeds"]
    table = Table(
        "", "scenes", "% (95 %)", "without lines", title=f"{report['scenario']}, seeds {first}–{last}, oracle"
    )
    for name, words in QUESTIONS.items():
        share, reached = report["shares"][name], report["shares_without_straight_lines"][name]
        table.add_row(words, f"{share['count']}/{share['trials']}", _percent(share), _percent(reached))
    console.print(table)
    console.print(
        f"target for one grasp: {100 * low:.0f}–{100 * high:.0f} %; without lines: inverse kinematics alone, no "
        f"straight lines; {report['no_common_grasp']} scenes without a common grasp, arm ignored",
        highlight=False,
    )
    if "direct" in report:
        direct, suffices = report["direct"], report["shares"]["both"]["count"]
        console.print(
            f"direct plans {direct['planned']} scenes, {direct['of_one_grasp_seeds']} of the {suffices} in which one "
            f"grasp suffices\nmissed by direct: {direct['missed_by_direct']}\n"
            f"missed by the oracle: {direct['missed_by_oracle']}",
            highlight=False,
        )
    for part in (report, report.get("direct", {})):
        print_crashes(part.get("crashed", {}))


def _percent(share: Record) -> str:
    return percent(share["count"], share["trials"], share["share_95"], 1)


def _paint(report: Record, _: Sequence[Record], axes: Axes) -> None:
    targets = report["targets"]
    series = {
        QUESTIONS[name]: [round(100 * target[name] / target["trials"], 1) for target in targets.values()]
        for name in ("goal", "both")
    }
    names = [target.split("_", 1)[-1].replace("_", "\n") for target in targets]
    bars(axes, names, series, (OURS_LIGHT, OURS))
    axes.tick_params(axis="x", labelsize=6)
    axes.set_ylim(0, 135)
    axes.set_ylabel("scenes (%)")
    axes.set_title(f"{report['scenario']}: {report['trials']} scenes, oracle")
