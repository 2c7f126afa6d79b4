"""Times of the planner's modules, warm, beside the paper's figures and a peer measured in the same run."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import numpy as np
import trimesh
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

import regrasp_gym

PAPER_STAB_POSE, PAPER_GRASP_GEN = 2.66e-3, 0.180
"""Seconds per trial of the paper's C++ implementation on an i5-13600KF (Song et al., §IV-B)."""


def modules(
    env: str = "regrasp_gym/PandaYCB-v0",
    scenes: int = 20,
    repeats: int = 5,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> None:
    """Time StabPose, GraspGen and whole plans, after everything is compiled.

    Args:
        env: id of the environment whose scenes are planned.
        scenes: seeds 0 to this, exclusive.
        repeats: timed calls per module and scene; the least is taken.
        json_file: write the figures as JSON.
    """
    from regrasp_planner import generate_grasps, plan, stable_poses

    made = gymnasium.make(env)
    inner = regrasp_gym.PlannerExpert(made).env
    robot = inner.planner_robot
    rng = np.random.default_rng(0)
    hulls = [trimesh.convex.convex_hull(rng.normal(size=(60, 3))) for _ in range(scenes)]
    vertices = [hull.vertices * 0.05 for hull in hulls]
    rows: dict[str, list[float]] = {}

    def measure(name: str, call: Callable[[], Any], times: int = repeats) -> None:
        # Once for whatever has to be compiled, then the least of several, which the machine disturbs least.
        call()
        rows.setdefault(name, []).append(min(_seconds(call) for _ in range(times)))

    for points, hull in track(list(zip(vertices, hulls, strict=True)), description="StabPose"):
        measure("StabPose, hull of 60 points", partial(stable_poses, points))
        peer = trimesh.Trimesh(hull.vertices * 0.05, hull.faces)
        measure("trimesh compute_stable_poses, same hulls", partial(trimesh.poses.compute_stable_poses, peer), 1)
    for seed in track(range(scenes), description="plans"):
        made.reset(seed=seed)
        task = inner.task()
        body, both = task.target, (task.pick, task.place)
        measure("StabPose, targets of the scenes", partial(stable_poses, body.hull_vertices(), body.center_of_mass))
        measure("GraspGen, pick and place", partial(generate_grasps, body, both, robot.gripper))
        for strategy in ("direct", "static"):
            outcome = plan(task, robot, strategy)
            name = f"whole plan, {strategy}" + ("" if outcome.success else ", none found")
            measure(name, partial(plan, task, robot, strategy), 1)

    title = f"least of {repeats} warm calls per scene or hull (plans and trimesh: one call); spread over scenes"
    table = Table("module", "scenes", "median (ms)", "90 % (ms)", "paper (ms)", title=title)
    paper = {"StabPose, hull of 60 points": PAPER_STAB_POSE, "GraspGen, pick and place": PAPER_GRASP_GEN}
    figures = {}
    for name in sorted(rows):
        median, p90 = np.quantile(rows[name], [0.5, 0.9])
        figures[name] = {"calls": len(rows[name]), "median": float(median), "p90": float(p90)}
        claimed = f"{1e3 * paper[name]:.2f}" if name in paper else ""
        table.add_row(name, str(len(rows[name])), f"{1e3 * median:.2f}", f"{1e3 * p90:.2f}", claimed)
    Console().print(table)
    if json_file:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        versions = {name: version(name) for name in ("regrasp-gym", "jax", "numpy", "scipy", "trimesh")}
        report = {"env": env, "seconds": figures, "versions": versions, "machine": platform.machine()}
        json_file.write_text(json.dumps(report, indent=2) + "\n")
    made.close()


def _seconds(call: Callable[[], Any]) -> float:
    began = time.perf_counter()
    call()
    return time.perf_counter() - began
