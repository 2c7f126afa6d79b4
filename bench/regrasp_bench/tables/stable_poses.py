"""StabPose beside trimesh and drops in MuJoCo: stable poses found, poses invented, and times."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float
from rich.console import Console
from rich.table import Table
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from regrasp_bench.options import PlotOptions
from regrasp_bench.tables.benchmark import Presentation, run_benchmark
from regrasp_bench.tables.drops import SAME_POSE, DropTable
from regrasp_bench.tables.hulls import random_hull, stone_of
from regrasp_bench.tables.summary import NOTHING, completed, mean, median, milliseconds
from regrasp_bench.tables.timing import least_seconds
from regrasp_gym.objects import OBJECTS
from regrasp_gym.objects.model import ObjectModel
from regrasp_gym.reports.plots import OURS, OURS_LIGHT, PEER, bars
from regrasp_gym.reports.report import Record
from regrasp_gym.reports.trials import crashes, print_crashes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from regrasp_planner import StablePoses

POINTS = (12, 200)
"""Least and largest number of points of the random hulls."""

PAPER_SECONDS = 2.66e-3
"""Time of the paper's C++ implementation on an i5-13600KF (Song et al., §IV-B)."""

TIMED_POINTS = 60
TIMED_HULLS = 20
SIZE = 0.05
"""Radius of the random hulls along their longest axis, metres."""

HEIGHT = 0.002
"""Height of drops above the table, metres."""


@dataclass(frozen=True, kw_only=True)
class StablePosesOptions(PlotOptions):
    """Compare StabPose with trimesh and with drops, over the shipped objects, random hulls, and 20 hulls of 60 points.

    The random hulls have 12 to 200 points on ellipsoids. StabPose and trimesh are timed in turn on the same hulls, from
    the points to the poses with everything included, and trimesh also with the hull made beforehand. Drops start in
    random orientations. An interrupted run resumes. Times are reliable only with one worker and an idle machine.
    """

    hulls: int = 200
    """Random hulls."""
    drops: int = 24
    """Drops per object and hull."""
    repeats: int = 9
    """Timed calls of each; the least time counts, which disturbances affect least."""
    records: Path = Path("outputs/bench/stable_poses.jsonl")


def stable_poses(options: StablePosesOptions) -> int:
    """Run the benchmark; returns the exit code."""
    setting = {"benchmark": "stable-poses", "version": version("regrasp-gym")}
    setting |= options.values("hulls", "drops", "repeats")
    trials = range(len(OBJECTS) + options.hulls + TIMED_HULLS)
    presentation = Presentation(_show, _paint, 2, ("regrasp-gym", "jax", "numpy", "scipy", "trimesh", "mujoco"))
    return run_benchmark(options, setting, trials, _prepare, summarise, presentation, "stable poses")


def summarise(setting: Record, done: Sequence[Record]) -> Record:
    """One row per kind of object."""
    ended = completed(done)
    kinds = dict.fromkeys(record["kind"] for record in ended)
    rows = {kind: _row([record for record in ended if record["kind"] == kind]) for kind in kinds}
    return {
        **{key: value for key, value in setting.items() if key != "version"},
        "within_degrees": float(np.rad2deg(SAME_POSE)),
        "paper_seconds": PAPER_SECONDS,
        "kinds": {**rows, "all": _row(ended)},
        "crashed": crashes(done),
    }


def _row(records: Sequence[Record]) -> Record:
    found = [record["probability_found"] for record in records]
    landed = [record["drops"] for record in records if record["drops"]["rested"]]
    names = ("stab_pose", "trimesh", "trimesh_given_the_hull")
    times = {name: np.array([record["seconds"][name] for record in records]) for name in names}
    return {
        "objects": len(records),
        "poses": sum(record["poses"] for record in records),
        "invented": sum(record["invented"] for record in records),
        "probability_found_mean": mean(found),
        "probability_found_least": min(found, default=None),
        "seconds": {
            **{name: median(values) for name, values in times.items()},
            "drop": median([drops["seconds"] for drops in landed]),
            "drops_per_object": median([drops["seconds"] * drops["count"] for drops in landed]),
        },
        "times_faster": {name: median(times[name] / times["stab_pose"]) for name in names[1:]},
        "drops": {
            "count": sum(drops["rested"] for drops in landed),
            "into_a_pose_found": _ratio(landed, "into_a_pose_found"),
            "into_a_pose_trimesh_finds": _ratio(landed, "into_a_pose_trimesh_finds"),
            "into_the_pose_of_the_start": _ratio(landed, "into_the_pose_of_the_start"),
        },
    }


def _ratio(landed: Sequence[Record], name: str) -> float | None:
    total = sum(drops["rested"] for drops in landed)
    return sum(drops[name] for drops in landed) / total if total else None


# --- trials -----------------------------------------------------------------------------------------------------------


def _prepare(setting: Record) -> Callable[[int], Record]:
    return partial(_compare, setting)


def trial_object(trial: int, hulls: int) -> tuple[str, ObjectModel]:
    """Kind and shape of a trial: the shipped objects, then random hulls, then hulls of `TIMED_POINTS` points."""
    names = sorted(OBJECTS)
    if trial < len(names):
        return "shipped objects", OBJECTS[names[trial]]
    rng = np.random.default_rng([trial, 0x57AB])
    timed = trial >= len(names) + hulls
    count = TIMED_POINTS if timed else int(rng.integers(POINTS[0], POINTS[1] + 1))
    points = SIZE * random_hull(rng, count) * rng.uniform(0.4, 1.0, 3)
    kind = f"hulls of {TIMED_POINTS} points" if timed else f"hulls of {POINTS[0]}–{POINTS[1]} points"
    return kind, stone_of(points, f"hull_{trial}")


def _compare(setting: Record, trial: int) -> Record:
    import trimesh

    from regrasp_planner import stable_poses as stab_pose

    kind, thing = trial_object(trial, setting["hulls"])
    # Both get the points and the same centre of mass, the solid's, at the origin of the object's frame.
    points, center = np.concatenate(thing.pieces), np.zeros(3)

    def of_hull(mesh: trimesh.Trimesh) -> tuple[Float[np.ndarray, "T 4 4"], Float[np.ndarray, " T"]]:
        return trimesh.poses.compute_stable_poses(mesh, center_mass=center, sigma=0, n_samples=1, threshold=0)

    hull = trimesh.convex.convex_hull(points)
    timed = least_seconds(
        {
            "stab_pose": lambda: stab_pose(points, center),
            "trimesh": lambda: of_hull(trimesh.convex.convex_hull(points)),
            "trimesh_given_the_hull": lambda: of_hull(hull),
        },
        setting["repeats"],
    )
    poses: StablePoses = timed["stab_pose"][1]
    transforms, probability = timed["trimesh_given_the_hull"][1]
    expected = -transforms[:, 2, :3]
    near = expected @ poses.directions.T > np.cos(SAME_POSE)
    return {
        "kind": kind,
        "thing": thing.name,
        "vertices": len(poses.corners),
        "poses": len(poses),
        "poses_of_trimesh": len(expected),
        "probability_found": float(probability[near.any(axis=1)].sum() / probability.sum()),
        "invented": int((~is_stable(points - center, poses.directions)).sum()),
        "seconds": {name: seconds for name, (seconds, _) in timed.items()},
        "drops": _drops(thing, poses, expected, setting["drops"], np.random.default_rng([trial, 0xD809])),
    }


def _drops(
    thing: ObjectModel, poses: StablePoses, expected: Float[np.ndarray, "T 3"], count: int, rng: np.random.Generator
) -> Record:
    table = DropTable(thing)
    turns = Rotation.random(count, rng)
    began = time.perf_counter()
    landings = [table.drop(turn.as_matrix(), HEIGHT) for turn in turns]
    seconds = time.perf_counter() - began
    rested = [landing for landing in landings if landing.rested]
    downs = -turns.as_matrix()[:, 2]
    nearest = (downs @ poses.starts.T).argmax(axis=1)
    predicted = poses.directions[poses.basin[nearest]]
    pairs = zip(landings, predicted, strict=True)
    return {
        "count": count,
        "rested": len(rested),
        "seconds": seconds / max(count, 1),
        "into_a_pose_found": sum(any(map(landing.settled_into, poses.directions)) for landing in rested),
        "into_a_pose_trimesh_finds": sum(any(map(landing.settled_into, expected)) for landing in rested),
        "into_the_pose_of_the_start": sum(landing.settled_into(direction) for landing, direction in pairs),
    }


def is_stable(points: Float[np.ndarray, "N 3"], directions: Float[np.ndarray, "m 3"]) -> Bool[np.ndarray, " m"]:
    """Whether an object, with its centre of mass at the origin, is statically stable with each direction down.

    It is if the lowest points span a facet and the centre of mass is above the facet's interior.
    """
    found = np.zeros(len(directions), bool)
    for k, direction in enumerate(directions):
        heights = points @ direction
        lowest = points[heights > heights.max() - 1e-6 * np.ptp(heights)]
        if len(lowest) >= 3:
            across = np.linalg.svd(direction[None])[2][1:]
            # The centre of mass projects to the origin of the plane.
            found[k] = (ConvexHull(lowest @ across.T).equations[:, 2] < 0).all()
    return found


# --- what is shown ----------------------------------------------------------------------------------------------------


def _show(report: Record) -> None:
    console = Console()
    title = f"stable poses; the same within {report['within_degrees']:.0f}°; times: median over objects, ms"
    table = Table("", *report["kinds"], title=title)

    def add(name: str, text: Callable[[Record], str]) -> None:
        table.add_row(name, *(text(row) for row in report["kinds"].values()))

    add("objects", lambda row: str(row["objects"]))
    add("poses found", lambda row: str(row["poses"]))
    add("invented", lambda row: str(row["invented"]))
    add("landing probability found, mean", lambda row: _percent(row["probability_found_mean"]))
    add("… least", lambda row: _percent(row["probability_found_least"]))
    add("StabPose", lambda row: milliseconds(row["seconds"]["stab_pose"], 2))
    add("trimesh", lambda row: milliseconds(row["seconds"]["trimesh"], 2))
    add("… given the hull", lambda row: milliseconds(row["seconds"]["trimesh_given_the_hull"], 2))
    add("times faster", lambda row: _times(row["times_faster"]["trimesh"]))
    add("… than given the hull", lambda row: _times(row["times_faster"]["trimesh_given_the_hull"]))
    add("one drop in MuJoCo", lambda row: milliseconds(row["seconds"]["drop"], 2))
    add("drops into a pose found", lambda row: _percent(row["drops"]["into_a_pose_found"]))
    add("… into one that trimesh finds", lambda row: _percent(row["drops"]["into_a_pose_trimesh_finds"]))
    add("… into that of the nearest start", lambda row: _percent(row["drops"]["into_the_pose_of_the_start"]))
    console.print(table)
    console.print(f"paper: {1e3 * report['paper_seconds']:.2f} ms (C++, i5-13600KF)", highlight=False)
    print_crashes(report["crashed"], "trials")


def _percent(share: float | None) -> str:
    return NOTHING if share is None else f"{100 * share:.2f} %"


def _times(factor: float | None) -> str:
    return NOTHING if factor is None else f"{factor:.1f}"


def _paint(report: Record, done: Sequence[Record], left: Axes, right: Axes) -> None:
    ended = completed(done)
    vertices = [record["vertices"] for record in ended]
    drops = [record["drops"]["seconds"] * record["drops"]["count"] for record in ended]
    series = {
        "StabPose": ([record["seconds"]["stab_pose"] for record in ended], OURS),
        "trimesh": ([record["seconds"]["trimesh"] for record in ended], PEER),
        f"{report['drops']} drops in MuJoCo": (drops, OURS_LIGHT),
    }
    for name, (seconds, colour) in series.items():
        left.scatter(vertices, 1e3 * np.array(seconds), s=8, color=colour, label=name)
    left.axhline(1e3 * report["paper_seconds"], color="#555555", linestyle="--", linewidth=0.8, label="paper (C++)")
    left.set_yscale("log")
    left.set_xlabel("vertices of the hull")
    left.set_ylabel("time (ms)")
    left.legend(fontsize=7, loc="upper left", ncols=2)
    left.set_ylim(top=left.get_ylim()[1] * 8)
    timed = report["kinds"].get(f"hulls of {TIMED_POINTS} points")
    if timed:
        names = ("stab_pose", "trimesh", "trimesh_given_the_hull", "drop")
        values = [round(1e3 * timed["seconds"][name], 2) if timed["seconds"][name] else None for name in names]
        groups = ["StabPose", "trimesh", "trimesh,\ngiven the hull", "one drop\nin MuJoCo", "paper\n(C++)"]
        bars(right, groups, {"median over hulls": [*values, 1e3 * PAPER_SECONDS]}, (OURS,))
        right.set_ylabel(f"time for a hull of {TIMED_POINTS} points (ms)")
