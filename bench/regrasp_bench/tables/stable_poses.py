"""StabPose beside trimesh and drops in MuJoCo: which stable poses are found, which invented, and in what time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro
from jaxtyping import Bool, Float
from rich.console import Console
from rich.table import Table
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from regrasp_bench.tables.drops import SAME_POSE, DropTable, random_hull, stone_of
from regrasp_gym.objects import OBJECTS
from regrasp_gym.objects.model import ObjectModel
from regrasp_gym.reports.plots import OURS, OURS_TOO, PEER, bars, check_format, draw
from regrasp_gym.reports.trials import Record, crashes, run_trials, write_report

if TYPE_CHECKING:
    from matplotlib.axes import Axes

POINTS = (12, 200)
"""Least and greatest number of points of the random hulls."""

PAPER_SECONDS = 2.66e-3
"""Time of the paper's C++ implementation on an i5-13600KF (Song et al., §IV-B)."""

TIMED_POINTS = 60
TIMED_HULLS = 20
SIZE = 0.05
"""Radius of the random hulls along their longest axis, metres."""

HEIGHT = 0.002
"""Height above the table from which objects are dropped, metres."""


def stable_poses(
    hulls: int = 200,
    drops: int = 24,
    repeats: int = 9,
    workers: int = 1,
    records: Path = Path("outputs/bench/stable_poses.jsonl"),
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    plot_file: Annotated[Path | None, tyro.conf.arg(name="plot")] = None,
) -> None:
    """Compare StabPose with trimesh and with drops, over the shipped objects, random hulls, and 20 hulls of 60 points.

    The random hulls have 12 to 200 points on ellipsoids. StabPose and trimesh are timed turn by turn on the same hulls,
    from the points to the poses with everything included, and trimesh also with the hull made for it beforehand. The
    drops begin in random orientations. An interrupted run goes on where it stopped; for the times to mean something run
    it with one worker and nothing beside it.

    Args:
        hulls: random hulls.
        drops: per object and hull.
        repeats: timed calls of each; the least is taken, which the machine disturbs least.
        workers: processes.
        records: one JSON line per object or hull, appended as they end.
        json_file: write the summary as JSON.
        plot_file: draw it (.svg, .png or .pdf).
    """
    check_format(plot_file)
    setting: Record = {
        "benchmark": "stable-poses",
        "version": version("regrasp-gym"),
        "hulls": hulls,
        "drops": drops,
        "repeats": repeats,
    }
    trials = range(len(OBJECTS) + hulls + TIMED_HULLS)
    done = run_trials(setting, trials, _prepare, workers=workers, records=records, label="stable poses")
    report = summarise(setting, done)
    _show(report)
    write_report(json_file, report, ("regrasp-gym", "jax", "numpy", "scipy", "trimesh", "mujoco"))
    draw(plot_file, partial(_paint, report, done), panels=2)


def summarise(setting: Record, done: Sequence[Record]) -> Record:
    """One row per kind of object, from the records of the trials."""
    ended = [record for record in done if "crashed" not in record]
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
        "probability_found_mean": _mean(found),
        "probability_found_least": min(found, default=None),
        "seconds": {
            **{name: _median(values) for name, values in times.items()},
            "drop": _median([drops["seconds"] for drops in landed]),
            "drops_per_object": _median([drops["seconds"] * drops["count"] for drops in landed]),
        },
        "times_faster": {name: _median(times[name] / times["stab_pose"]) for name in names[1:]},
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


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _median(values: Sequence[float] | Float[np.ndarray, " N"]) -> float | None:
    return float(np.median(values)) if len(values) else None


# --- trials -----------------------------------------------------------------------------------------------------------


def _prepare(setting: Record) -> Callable[[int], Record]:
    return partial(_compare, setting)


def subject(trial: int, hulls: int) -> tuple[str, ObjectModel]:
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

    from regrasp_planner import stable_poses as ours

    kind, thing = subject(trial, setting["hulls"])
    # Both get the bare points and the same centre of mass: of the solid, the origin of the object's frame.
    points, center = np.concatenate(thing.pieces), np.zeros(3)

    def of_hull(mesh: trimesh.Trimesh) -> tuple[Float[np.ndarray, "T 4 4"], Float[np.ndarray, " T"]]:
        return trimesh.poses.compute_stable_poses(mesh, center_mass=center, sigma=0, n_samples=1, threshold=0)

    hull = trimesh.convex.convex_hull(points)
    calls: dict[str, Callable[[], Any]] = {
        "stab_pose": lambda: ours(points, center),
        "trimesh": lambda: of_hull(trimesh.convex.convex_hull(points)),
        "trimesh_given_the_hull": lambda: of_hull(hull),
    }
    poses = ours(points, center)
    transforms, probability = of_hull(hull)
    expected = -transforms[:, 2, :3]
    near = expected @ poses.directions.T > np.cos(SAME_POSE)
    seconds = dict.fromkeys(calls, np.inf)
    for _ in range(setting["repeats"]):
        seconds = {name: min(seconds[name], _seconds(call)) for name, call in calls.items()}
    return {
        "kind": kind,
        "thing": thing.name,
        "vertices": len(poses.corners),
        "poses": len(poses),
        "poses_of_trimesh": len(expected),
        "probability_found": float(probability[near.any(axis=1)].sum() / probability.sum()),
        "invented": int((~stands(points - center, poses.directions)).sum()),
        "seconds": seconds,
        "drops": _drops(thing, poses, expected, setting["drops"], np.random.default_rng([trial, 0xD809])),
    }


def _drops(
    thing: ObjectModel, poses: Any, expected: Float[np.ndarray, "T 3"], count: int, rng: np.random.Generator
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


def stands(points: Float[np.ndarray, "N 3"], directions: Float[np.ndarray, "m 3"]) -> Bool[np.ndarray, " m"]:
    """Whether an object with its centre of mass at the origin rests statically with each direction down.

    It does if the lowest points span a facet and the centre of mass is above the inside of it.
    """
    found = np.zeros(len(directions), bool)
    for k, direction in enumerate(directions):
        heights = points @ direction
        lowest = points[heights > heights.max() - 1e-6 * np.ptp(heights)]
        if len(lowest) >= 3:
            across = np.linalg.svd(direction[None])[2][1:]
            # The foot of the centre of mass is the origin of the plane.
            found[k] = (ConvexHull(lowest @ across.T).equations[:, 2] < 0).all()
    return found


def _seconds(call: Callable[[], Any]) -> float:
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


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
    add("StabPose", lambda row: _ms(row["seconds"]["stab_pose"]))
    add("trimesh", lambda row: _ms(row["seconds"]["trimesh"]))
    add("… given the hull", lambda row: _ms(row["seconds"]["trimesh_given_the_hull"]))
    add("times faster", lambda row: _times(row["times_faster"]["trimesh"]))
    add("… than given the hull", lambda row: _times(row["times_faster"]["trimesh_given_the_hull"]))
    add("one drop in MuJoCo", lambda row: _ms(row["seconds"]["drop"]))
    add("drops into a pose found", lambda row: _percent(row["drops"]["into_a_pose_found"]))
    add("… into one that trimesh finds", lambda row: _percent(row["drops"]["into_a_pose_trimesh_finds"]))
    add("… into that of the nearest start", lambda row: _percent(row["drops"]["into_the_pose_of_the_start"]))
    console.print(table)
    console.print(f"paper: {1e3 * report['paper_seconds']:.2f} ms (C++, i5-13600KF)", highlight=False)
    for error, numbers in report["crashed"].items():
        console.print(f"crashed: {error}, trials {numbers}", style="red", markup=False, highlight=False)


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.2f} %"


def _times(factor: float | None) -> str:
    return "–" if factor is None else f"{factor:.1f}"


def _ms(seconds: float | None) -> str:
    return "–" if seconds is None else f"{1e3 * seconds:.2f}"


def _paint(report: Record, done: Sequence[Record], left: Axes, right: Axes) -> None:
    ended = [record for record in done if "crashed" not in record]
    vertices = [record["vertices"] for record in ended]
    drops = [record["drops"]["seconds"] * record["drops"]["count"] for record in ended]
    series = {
        "StabPose": ([record["seconds"]["stab_pose"] for record in ended], OURS),
        "trimesh": ([record["seconds"]["trimesh"] for record in ended], PEER),
        f"{report['drops']} drops in MuJoCo": (drops, OURS_TOO),
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
