"""How often one grasp is enough, by the oracle, and how many of those scenes the planner's direct strategy solves."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import gymnasium
import tyro
from rich.console import Console
from rich.table import Table

import regrasp_gym
from regrasp_bench.oracle.oracle import Oracle, Use
from regrasp_bench.tables.episodes import plan_episode
from regrasp_bench.tables.paper import ENVS, Scenario
from regrasp_gym.envs.base import RegraspEnv
from regrasp_gym.errors import BenchError
from regrasp_gym.reports.plots import OURS, OURS_TOO, bars, check_format, draw
from regrasp_gym.reports.trials import Record, crashes, run_trials, wilson, write_report

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ASKED = {"pick": "taken at all", "goal": "placed at all", "both": "one grasp suffices"}
"""What the oracle is asked, by the name in its verdict."""
AIMED: dict[Scenario, tuple[float, float]] = {"panda": (0.39, 0.45), "excavator": (0.33, 0.39)}
"""Share of scenes in which one grasp is to suffice."""


def difficulty(
    scenario: Scenario = "panda",
    trials: int = 300,
    first_seed: int = 0,
    direct: bool = False,
    workers: int = 1,
    records: Path = Path("outputs/bench/difficulty.jsonl"),
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    plot_file: Annotated[Path | None, tyro.conf.arg(name="plot")] = None,
) -> None:
    """In how many scenes one grasp suffices, by an exhaustive search that is not the planner.

    Args:
        scenario: robot and objects.
        trials: scenes, one per seed.
        first_seed: seed of the first scene.
        direct: plan every scene with the strategy ``direct`` too, and compare.
        workers: processes.
        records: one JSON line per scene, appended as they end.
        json_file: write the summary as JSON.
        plot_file: draw the shares by target (.svg, .png or .pdf).
    """
    check_format(plot_file)
    env = ENVS[scenario]
    if env not in gymnasium.registry:
        raise BenchError(f"scenario {scenario!r} needs the environment {env}, which is not there yet")
    seeds = range(first_seed, first_seed + trials)
    setting: Record = {"benchmark": "difficulty", "env": env, "config": _config(env), "version": version("regrasp-gym")}
    judged = run_trials(setting, seeds, _prepare_oracle, workers=workers, records=records, label="oracle")
    report = {"scenario": scenario, "env": env, "seeds": [seeds.start, seeds.stop - 1], **summarise(judged)}
    if direct:
        setting |= {"strategy": "direct"}
        planned = run_trials(setting, seeds, _prepare_direct, workers=workers, records=records, label="direct")
        report["direct"] = compare(judged, planned)
    _show(report, AIMED[scenario])
    write_report(json_file, report, ("regrasp-gym", "coal", "jax", "numpy", "scipy"))
    draw(plot_file, partial(_paint, report))


def summarise(judged: Sequence[Record]) -> Record:
    """Shares over all scenes and by target, from the oracle's records."""
    ended = [record for record in judged if "crashed" not in record]
    by_target: defaultdict[str, list[Record]] = defaultdict(list)
    for record in ended:
        by_target[record["target"]].append(record)
    return {
        "trials": len(judged),
        "shares": {name: _share(ended, name, Use.MOVED) for name in ASKED},
        "shares_without_straight_lines": {name: _share(ended, name, Use.REACHED) for name in ASKED},
        "no_common_grasp": sum(record["common_grasps"] == 0 for record in ended),
        "one_grasp_seeds": [record["trial"] for record in ended if record["both"] == Use.MOVED],
        "targets": {
            target: {"trials": len(some), **{name: _share(some, name, Use.MOVED)["count"] for name in ASKED}}
            for target, some in sorted(by_target.items())
        },
        "crashed": crashes(judged),
    }


def compare(judged: Sequence[Record], planned: Sequence[Record]) -> Record:
    """How the direct strategy does where the oracle says that one grasp suffices, and where it says not."""
    verdicts = {record["trial"]: record["both"] for record in judged if "crashed" not in record}
    found = {record["trial"] for record in planned if record.get("planned") and record["trial"] in verdicts}
    suffices = {seed for seed, both in verdicts.items() if both == Use.MOVED}
    return {
        "planned": len(found),
        "planned_share_95": wilson(len(found), len(verdicts)),
        "of_one_grasp_seeds": len(found & suffices),
        "of_one_grasp_seeds_share_95": wilson(len(found & suffices), len(suffices)),
        "missed_by_direct": sorted(suffices - found),
        "missed_by_oracle": sorted(found - suffices),
        "crashed": crashes(planned),
    }


def _share(records: Sequence[Record], name: str, least: Use) -> Record:
    count = sum(record[name] >= least for record in records)
    return {"count": count, "trials": len(records), "share_95": wilson(count, len(records))}


# --- trials -----------------------------------------------------------------------------------------------------------


def _config(env: str) -> str:
    """The scenes' configuration in words, so that records of other scenes are told apart."""
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


def _show(report: Record, aimed: tuple[float, float]) -> None:
    console = Console()
    first, last = report["seeds"]
    table = Table(
        "", "scenes", "% (95 %)", "without lines", title=f"{report['scenario']}, seeds {first}–{last}, oracle"
    )
    for name, words in ASKED.items():
        share, reached = report["shares"][name], report["shares_without_straight_lines"][name]
        table.add_row(words, f"{share['count']}/{share['trials']}", _percent(share), _percent(reached))
    console.print(table)
    console.print(
        f"aimed at for one grasp: {100 * aimed[0]:.0f}–{100 * aimed[1]:.0f} %; without lines: only inverse kinematics, "
        f"not the straight lines to and fro; {report['no_common_grasp']} scenes without a common grasp, the arm aside",
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
        for error, seeds in part.get("crashed", {}).items():
            console.print(f"crashed: {error}, seeds {seeds}", style="red", markup=False, highlight=False)


def _percent(share: Record) -> str:
    if not share["trials"]:
        return "–"
    low, high = share["share_95"]
    return f"{100 * share['count'] / share['trials']:.1f} ({100 * low:.0f}–{100 * high:.0f})"


def _paint(report: Record, axes: Axes) -> None:
    targets = report["targets"]
    series = {
        ASKED[name]: [round(100 * target[name] / target["trials"], 1) for target in targets.values()]
        for name in ("goal", "both")
    }
    names = [target.split("_", 1)[-1].replace("_", "\n") for target in targets]
    bars(axes, names, series, (OURS_TOO, OURS))
    axes.tick_params(axis="x", labelsize=6)
    axes.set_ylim(0, 135)
    axes.set_ylabel("scenes (%)")
    axes.set_title(f"{report['scenario']}: {report['trials']} scenes, oracle")
