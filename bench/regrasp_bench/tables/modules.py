"""Times and successes of the planner's modules, warm, beside peers called in turn with them and the paper's figures."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import gymnasium
import numpy as np
import trimesh
import tyro
from rich.console import Console
from rich.table import Table

import regrasp_gym
from regrasp_gym.reports.plots import OURS, OURS_TOO, PAPER, PEER, check_format, draw, shares
from regrasp_gym.reports.trials import Record, crashes, run_trials, wilson, write_report

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from regrasp_planner import Robot, Task

STAB_POSE, TRIMESH = "StabPose, hull of 60 points", "trimesh, same hull"
TARGET, TRIMESH_TARGET = "StabPose, target", "trimesh, same target"
GRASP_GEN, UNIFORM, SAMPLING = "GraspGen", "GraspGen, uniform starts", "sampling"
PAPER_SECONDS = {STAB_POSE: 2.66e-3, GRASP_GEN: 0.180}
"""Seconds per trial of the paper's C++ implementation on an i5-13600KF (Song et al., §IV-B)."""
_COMPARED = ((STAB_POSE, TRIMESH), (TARGET, TRIMESH_TARGET), (GRASP_GEN, SAMPLING), (GRASP_GEN, UNIFORM))


def modules(
    env: str = "regrasp_gym/PandaYCB-v0",
    scenes: int = 20,
    first_seed: int = 0,
    repeats: int = 5,
    strategies: tuple[str, ...] = ("direct", "static", "nonstatic", "repeated"),
    workers: int = 1,
    records: Path = Path("outputs/bench/modules.jsonl"),
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    plot_file: Annotated[Path | None, tyro.conf.arg(name="plot")] = None,
) -> None:
    """Time StabPose beside trimesh, GraspGen beside the sampling baseline, and whole plans, after all is compiled.

    Args:
        env: id of the environment whose scenes are used.
        scenes: how many; one random hull goes with each.
        first_seed: seed of the first scene and hull.
        repeats: timed calls of each module and peer, after one untimed; the least counts. Plans and the baseline
            are timed once.
        strategies: of the whole plans.
        workers: processes; with more than one the times are not to be trusted.
        records: one JSON line per scene, appended as they end.
        json_file: write the summary as JSON.
        plot_file: draw the times (.svg, .png or .pdf).
    """
    check_format(plot_file)
    setting: Record = {"env": env, "repeats": repeats, "strategies": strategies}
    setting["versions"] = {name: version(name) for name in ("regrasp-gym", "trimesh")}
    seeds = range(first_seed, first_seed + scenes)
    ended = run_trials(setting, seeds, _prepare, workers=workers, records=records, label="scenes")
    report = summarise(setting, ended)
    _show(report)
    write_report(json_file, report, ("regrasp-gym", "jax", "numpy", "scipy", "trimesh", "coal"))
    draw(plot_file, partial(_paint, ended), panels=2)


def summarise(setting: Record, scenes: Sequence[Record]) -> Record:
    """Figures by module, and how many times as long each peer takes."""
    rows = _rows(scenes)
    figures: Record = {}
    for name, calls in rows.items():
        seconds = [call["seconds"] for call in calls]
        figures[name] = {
            "calls": len(calls),
            "seconds_median": float(np.median(seconds)),
            "seconds_p90": float(np.quantile(seconds, 0.9)),
            "paper_seconds": PAPER_SECONDS.get(name),
        }
        if "found" in calls[0]:
            found = sum(call["found"] for call in calls)
            figures[name] |= {"found": found, "found_share_95": wilson(found, len(calls))}
            figures[name]["eval_grasp_calls_mean"] = float(np.mean([call["evaluations"] for call in calls]))
    ratios = {
        f"{other} / {one}": float(
            np.median([b["seconds"] / a["seconds"] for a, b in zip(rows[one], rows[other], strict=True)])
        )
        for one, other in _COMPARED
        if one in rows and other in rows
    }
    return {
        **setting,
        "seeds": [scenes[0]["trial"], scenes[-1]["trial"]] if scenes else [],
        "modules": figures,
        "time_ratio_median": ratios,
        "crashed": crashes(scenes),
    }


def _rows(scenes: Sequence[Record]) -> dict[str, list[Record]]:
    rows: dict[str, list[Record]] = {}
    for scene in scenes:
        for name, call in scene.get("calls", {}).items():
            rows.setdefault(name, []).append(call)
    return rows


# --- trials -----------------------------------------------------------------------------------------------------------


def _prepare(setting: Record) -> Callable[[int], Record]:
    made = gymnasium.make(setting["env"])
    inner = regrasp_gym.PlannerExpert(made).env

    def run(seed: int) -> Record:
        made.reset(seed=seed)
        task, robot = inner.task(), inner.planner_robot
        calls = _stable_poses(seed, task, setting["repeats"]) | _grasps(task, robot, setting["repeats"])
        return {"calls": calls | _plans(task, robot, setting["strategies"])}

    return run


def _stable_poses(seed: int, task: Task, repeats: int) -> dict[str, Record]:
    from regrasp_planner import stable_poses

    points = np.random.default_rng(seed).normal(size=(60, 3))
    # On an ellipsoid, so that all 60 are corners of the hull.
    hull = trimesh.convex.convex_hull(points / np.linalg.norm(points, axis=1, keepdims=True) * [0.03, 0.04, 0.05])
    body = task.target
    target = trimesh.convex.convex_hull(body.hull_vertices())
    calls = {
        STAB_POSE: partial(stable_poses, hull.vertices),
        TRIMESH: partial(trimesh.poses.compute_stable_poses, hull),
        TARGET: partial(stable_poses, body.hull_vertices(), body.center_of_mass),
        TRIMESH_TARGET: partial(trimesh.poses.compute_stable_poses, target, body.center_of_mass),
    }
    return {name: {"seconds": seconds} for name, (seconds, _) in _timed(calls, repeats).items()}


def _grasps(task: Task, robot: Robot, repeats: int) -> dict[str, Record]:
    from regrasp_planner import GraspGenOptions, generate_grasps
    from regrasp_planner.grasp.grasp import StartKind
    from regrasp_planner.grasp.sampling import sample_grasps

    scene = (task.target, (task.pick, task.place), robot.gripper)
    uniform = GraspGenOptions(starts=StartKind.UNIFORM)
    timed = _timed(
        {GRASP_GEN: partial(generate_grasps, *scene), UNIFORM: partial(generate_grasps, *scene, uniform)}, repeats
    )
    timed |= _timed({SAMPLING: partial(sample_grasps, *scene)}, 1)
    return {
        name: {"seconds": seconds, "found": bool(result.grasps), "evaluations": result.evaluations}
        for name, (seconds, result) in timed.items()
    }


def _plans(task: Task, robot: Robot, strategies: Sequence[str]) -> dict[str, Record]:
    from regrasp_planner import plan

    timed = _timed({f"plan, {strategy}": partial(plan, task, robot, strategy) for strategy in strategies}, 1)
    return {
        name: {"seconds": seconds, "found": result.success, "evaluations": result.stats.eval_grasp_calls}
        for name, (seconds, result) in timed.items()
    }


def _timed(calls: Mapping[str, Callable[[], Any]], repeats: int) -> dict[str, tuple[float, Any]]:
    """Least seconds of several calls each, taken in turn, and what they return."""
    # Once for whatever has to be compiled.
    results = {name: call() for name, call in calls.items()}
    least = dict.fromkeys(calls, np.inf)
    for _ in range(repeats):
        for name, call in calls.items():
            began = time.perf_counter()
            call()
            least[name] = min(least[name], time.perf_counter() - began)
    return {name: (least[name], results[name]) for name in calls}


# --- what is shown ----------------------------------------------------------------------------------------------------


def _show(report: Record) -> None:
    columns = ("module", "calls", "ms", "p90", "paper, ms", "found", "eval-grasp")
    table = Table(*columns, title=f"scenes and hulls {report['seeds']}, warm")
    for name, row in report["modules"].items():
        paper = row["paper_seconds"]
        table.add_row(
            name,
            str(row["calls"]),
            f"{1e3 * row['seconds_median']:.2f}",
            f"{1e3 * row['seconds_p90']:.2f}",
            "" if paper is None else f"{1e3 * paper:.2f}",
            f"{row['found']}" if "found" in row else "",
            f"{row['eval_grasp_calls_mean']:.0f}" if "found" in row else "",
        )
    console = Console()
    console.print(table)
    for pair, factor in report["time_ratio_median"].items():
        console.print(f"{pair}: {factor:.2f}, median ratio of times", highlight=False)
    for error, seeds in report["crashed"].items():
        console.print(f"crashed: {error}, seeds {seeds}", style="red", markup=False, highlight=False)


def _paint(scenes: Sequence[Record], *panels: Axes) -> None:
    rows = _rows(scenes)
    chosen = ((STAB_POSE, TRIMESH), (GRASP_GEN, UNIFORM, SAMPLING))
    colours = ((OURS, PEER), (OURS, OURS_TOO, PEER))
    for axes, names, shades in zip(panels, chosen, colours, strict=True):
        series = {name: np.array([call["seconds"] for call in rows.get(name, [])]) for name in names}
        axes.axvline(PAPER_SECONDS[names[0]], color=PAPER, linestyle="--", label="paper")
        shares(axes, series, "seconds per call", shades)
        axes.set_title(names[0].split(",")[0])
