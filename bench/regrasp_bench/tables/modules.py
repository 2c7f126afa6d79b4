"""Times and successes of the planner's modules, warm, beside their peers and the paper's figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import gymnasium
import numpy as np
import trimesh
from rich.console import Console
from rich.table import Table

import regrasp_gym
from regrasp_bench.options import PlotOptions, SceneOptions
from regrasp_bench.tables.benchmark import Presentation, run_benchmark
from regrasp_bench.tables.summary import median_and_p90, milliseconds, seed_range
from regrasp_bench.tables.timing import least_seconds
from regrasp_gym.reports.plots import OURS, OURS_LIGHT, PAPER, PEER, cumulative_shares
from regrasp_gym.reports.report import Record, package_versions, wilson
from regrasp_gym.reports.trials import crashes, print_crashes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from regrasp_planner import Robot, Task

STAB_POSE, TRIMESH = "StabPose, hull of 60 points", "trimesh, same hull"
TARGET, TRIMESH_TARGET = "StabPose, target", "trimesh, same target"
GRASP_GEN, UNIFORM, SAMPLING = "GraspGen", "GraspGen, uniform starts", "sampling"
PAPER_SECONDS = {STAB_POSE: 2.66e-3, GRASP_GEN: 0.180}
"""Seconds per trial of the paper's C++ implementation on an i5-13600KF (Song et al., §IV-B)."""
_COMPARED = ((STAB_POSE, TRIMESH), (TARGET, TRIMESH_TARGET), (GRASP_GEN, SAMPLING), (GRASP_GEN, UNIFORM))


@dataclass(frozen=True, kw_only=True)
class ModulesOptions(SceneOptions, PlotOptions):
    """Time StabPose beside trimesh, GraspGen beside the sampling baseline, and whole plans, after all is compiled."""

    scenes: int = 20
    """Number of scenes; one random hull goes with each."""
    first_seed: int = 0
    """Seed of the first scene and hull."""
    repeats: int = 5
    """Timed calls of each module and peer, after an untimed one; the least time counts. Plans and the baseline are
    timed once."""
    strategies: tuple[str, ...] = ("direct", "static", "nonstatic", "repeated")
    """Strategies of the whole plans."""
    records: Path = Path("outputs/bench/modules.jsonl")


def modules(options: ModulesOptions) -> int:
    """Run the benchmark; returns the exit code."""
    versions = package_versions(("regrasp-gym", "trimesh"))
    setting = {**options.values("env", "repeats", "strategies"), "versions": versions}
    presentation = Presentation(_show, _paint, 2, ("regrasp-gym", "jax", "numpy", "scipy", "trimesh", "coal"))
    return run_benchmark(options, setting, options.seeds, _prepare, summarise, presentation)


def summarise(setting: Record, scenes: Sequence[Record]) -> Record:
    """Figures by module, and the ratio of each peer's time to ours."""
    rows = _rows(scenes)
    figures: Record = {}
    for name, calls in rows.items():
        figures[name] = {
            "calls": len(calls),
            **median_and_p90([call["seconds"] for call in calls], "seconds_"),
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
        "seeds": seed_range(scenes),
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
    # On an ellipsoid, so that all 60 points are vertices of the hull.
    hull = trimesh.convex.convex_hull(points / np.linalg.norm(points, axis=1, keepdims=True) * [0.03, 0.04, 0.05])
    body = task.target
    target = trimesh.convex.convex_hull(body.hull_vertices())
    calls = {
        STAB_POSE: partial(stable_poses, hull.vertices),
        TRIMESH: partial(trimesh.poses.compute_stable_poses, hull),
        TARGET: partial(stable_poses, body.hull_vertices(), body.center_of_mass),
        TRIMESH_TARGET: partial(trimesh.poses.compute_stable_poses, target, body.center_of_mass),
    }
    return {name: {"seconds": seconds} for name, (seconds, _) in least_seconds(calls, repeats).items()}


def _grasps(task: Task, robot: Robot, repeats: int) -> dict[str, Record]:
    from regrasp_planner import GraspGenOptions, generate_grasps
    from regrasp_planner.grasp.grasp import StartKind
    from regrasp_planner.grasp.sampling import sample_grasps

    scene = (task.target, (task.pick, task.place), robot.gripper)
    uniform = GraspGenOptions(starts=StartKind.UNIFORM)
    timed = least_seconds(
        {GRASP_GEN: partial(generate_grasps, *scene), UNIFORM: partial(generate_grasps, *scene, uniform)}, repeats
    )
    timed |= least_seconds({SAMPLING: partial(sample_grasps, *scene)}, 1)
    return {
        name: {"seconds": seconds, "found": bool(result.grasps), "evaluations": result.evaluations}
        for name, (seconds, result) in timed.items()
    }


def _plans(task: Task, robot: Robot, strategies: Sequence[str]) -> dict[str, Record]:
    from regrasp_planner import plan

    timed = least_seconds({f"plan, {strategy}": partial(plan, task, robot, strategy) for strategy in strategies}, 1)
    return {
        name: {"seconds": seconds, "found": result.success, "evaluations": result.stats.eval_grasp_calls}
        for name, (seconds, result) in timed.items()
    }


# --- what is shown ----------------------------------------------------------------------------------------------------


def _show(report: Record) -> None:
    columns = ("module", "calls", "ms", "p90", "paper, ms", "found", "eval-grasp")
    table = Table(*columns, title=f"scenes and hulls {report['seeds']}, warm")
    for name, row in report["modules"].items():
        paper = row["paper_seconds"]
        table.add_row(
            name,
            str(row["calls"]),
            milliseconds(row["seconds_median"], 2),
            milliseconds(row["seconds_p90"], 2),
            "" if paper is None else milliseconds(paper, 2),
            f"{row['found']}" if "found" in row else "",
            f"{row['eval_grasp_calls_mean']:.0f}" if "found" in row else "",
        )
    console = Console()
    console.print(table)
    for pair, factor in report["time_ratio_median"].items():
        console.print(f"{pair}: {factor:.2f}, median ratio of times", highlight=False)
    print_crashes(report["crashed"])


def _paint(_: Record, scenes: Sequence[Record], *panels: Axes) -> None:
    rows = _rows(scenes)
    chosen = ((STAB_POSE, TRIMESH), (GRASP_GEN, UNIFORM, SAMPLING))
    colours = ((OURS, PEER), (OURS, OURS_LIGHT, PEER))
    for axes, names, shades in zip(panels, chosen, colours, strict=True):
        series = {name: np.array([call["seconds"] for call in rows.get(name, [])]) for name in names}
        axes.axvline(PAPER_SECONDS[names[0]], color=PAPER, linestyle="--", label="paper")
        cumulative_shares(axes, series, "seconds per call", shades)
        axes.set_title(names[0].split(",")[0])
