"""Signed distances beside coal's: their errors, and their times with and without gradients."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tyro
from jaxtyping import Float
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from regrasp_bench.options import PlotOptions
from regrasp_bench.peers.coal_shapes import polytope
from regrasp_bench.peers.optional import import_peer
from regrasp_bench.tables.benchmark import Presentation, run_benchmark
from regrasp_bench.tables.summary import NOTHING, completed
from regrasp_bench.tables.timing import mean_seconds
from regrasp_gym.reports.plots import OURS, OURS_LIGHT, PEER, bars, cumulative_shares
from regrasp_gym.reports.report import Record, package_versions
from regrasp_gym.reports.trials import crashes, print_crashes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from regrasp_planner import ConvexBody

DSF, CERTIFIED, THINNED = "distance", "certified", "thinned to 64"
"""What is compared with coal for accuracy. By default, bodies of more than 64 vertices are thinned."""
GRADIENT, QUICK, ALONE, COAL = "with gradients", "from one start", "one pair a call", "coal, one pair a call"
"""What else is timed: with gradients by both poses; overlaps from one start only; not in a batch."""
_FEW = 50
"""Pairs that are timed one pair a call."""


@dataclass(frozen=True)
class Pairs:
    """N pairs of hulls of the same number of vertices.

    Attributes:
        vertices_a, vertices_b: (N, V, 3) metres, all on their hull.
        poses_a, poses_b: (N, 7) wxyz_xyz.
    """

    vertices_a: Float[np.ndarray, "N V 3"]
    vertices_b: Float[np.ndarray, "N V 3"]
    poses_a: Float[np.ndarray, "N 7"]
    poses_b: Float[np.ndarray, "N 7"]


@dataclass(frozen=True, kw_only=True)
class DistanceOptions(PlotOptions):
    """Compare signed distances of random hulls, apart and overlapping, with coal's, which are exact.

    All pairs are timed as one batch, and coal pair by pair, in turn in one process, after everything is compiled.
    """

    vertices: tuple[int, ...] = (20, 60, 200)
    """Vertices of each hull; one table row per number."""
    pairs: int = 1000
    """Random pairs of hulls of 2 to 8 cm."""
    rounds: int = 7
    """Timed rounds."""
    workers: tyro.conf.Suppress[tyro.conf.Fixed[int]] = 1
    records: Path = Path("outputs/bench/distance.jsonl")


def distance(options: DistanceOptions) -> int:
    """Run the benchmark; returns the exit code."""
    setting = options.values("pairs", "rounds")
    setting["versions"] = package_versions(("regrasp-gym", "jax", "coal"))
    presentation = Presentation(_show, _paint, 2, ("regrasp-gym", "jax", "jaxlib", "numpy", "scipy", "coal"))
    label = "numbers of vertices"
    return run_benchmark(options, setting, options.vertices, _prepare, summarise, presentation, label)


def summarise(setting: Record, ended: Sequence[Record]) -> Record:
    """Errors of pairs that are apart and of pairs that overlap, and times per pair, by number of vertices."""
    rows: Record = {}
    for record in completed(ended):
        exact = np.array(record["exact"])
        row: Record = {"apart": {"pairs": int((exact > 0).sum())}, "overlapping": {"pairs": int((exact <= 0).sum())}}
        for group, chosen in (("apart", exact > 0), ("overlapping", exact <= 0)):
            for name, found in record["found"].items():
                row[group][name] = _errors(exact[chosen] - np.array(found)[chosen])
        angles = np.array(record["angles"])[exact > 0]
        row["normal_degrees"] = {"median": _quantile(angles, 0.5), "p99": _quantile(angles, 0.99)}
        row["seconds_per_pair"] = {name: float(np.median(times)) for name, times in record["seconds"].items()}
        row["seconds_per_pair_least"] = {name: min(times) for name, times in record["seconds"].items()}
        rows[str(record["trial"])] = row
    return {**setting, "vertices": rows, "crashed": crashes(ended)}


def _errors(short: Float[np.ndarray, " N"]) -> Record:
    """Statistics of how far distances fall short of the exact ones, metres."""
    return {
        "largest_excess": float(max(-short.min(), 0.0)) if len(short) else 0.0,
        "short_mean": float(short.mean()) if len(short) else 0.0,
        "short_p99": _quantile(short, 0.99),
        "short_max": _quantile(short, 1.0),
        "share_over_1_mm": float((short > 1e-3).mean()) if len(short) else 0.0,
    }


def _quantile(values: Float[np.ndarray, " N"], share: float) -> float:
    return float(np.quantile(values, share)) if len(values) else 0.0


# --- one number of vertices -------------------------------------------------------------------------------------------


def _prepare(setting: Record) -> Callable[[int], Record]:
    import_peer("coal")

    def run(vertices: int) -> Record:
        return compare(random_pairs(setting["pairs"], vertices), setting["rounds"])

    return run


def random_pairs(count: int, vertices: int, seed: int = 0) -> Pairs:
    """Pairs of random ellipsoids of 2 to 8 cm with random points on them, about half of the pairs overlapping."""
    rng = np.random.default_rng([seed, vertices])

    def hulls() -> Float[np.ndarray, "N V 3"]:
        points = rng.normal(size=(count, vertices, 3))
        points /= np.linalg.norm(points, axis=2, keepdims=True)
        return points * rng.uniform(0.01, 0.04, (count, 1, 3))

    turns = [Rotation.random(count, rng=rng).as_quat(scalar_first=True) for _ in range(2)]
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    apart = rng.uniform(0.0, 0.09, (count, 1)) * direction
    poses = [np.concatenate([turn, shift], axis=1) for turn, shift in zip(turns, (0 * apart, apart), strict=True)]
    return Pairs(hulls(), hulls(), *poses)


def compare(pairs: Pairs, rounds: int) -> Record:
    """Exact distances, those found, angles between normals (degrees), and seconds per pair of each round."""
    import jax

    from regrasp_planner import ConvexBody, certified_distance, separation

    count, vertices = pairs.vertices_a.shape[:2]

    def batch(hulls: Float[np.ndarray, "N V 3"], most: int) -> ConvexBody:
        # On the device, so that copying is not timed.
        stacked = ConvexBody.stack([ConvexBody.from_vertices(points, max_vertices=most) for points in hulls])
        return jax.device_put(stacked)

    full = batch(pairs.vertices_a, vertices), batch(pairs.vertices_b, vertices)
    poses = jax.device_put(pairs.poses_a), jax.device_put(pairs.poses_b)
    calls = _calls(full, poses)
    found = {DSF: calls[DSF](), CERTIFIED: certified_distance(full[0], poses[0], full[1], poses[1])}
    if vertices > 64:
        thin = batch(pairs.vertices_a, 64), batch(pairs.vertices_b, 64)
        calls[THINNED] = lambda: separation(thin[0], poses[0], thin[1], poses[1]).distance
        found[THINNED] = calls[THINNED]()
    exact, normals, calls[COAL] = _coal(pairs)
    ours = np.asarray(separation(full[0], poses[0], full[1], poses[1]).direction)
    cosine = np.clip((ours * normals).sum(axis=1), -1.0, 1.0)

    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        jax.block_until_ready(call())
    for turn in range(rounds):
        names = list(calls)
        for name in names if turn % 2 == 0 else reversed(names):
            elapsed = mean_seconds(lambda name=name: jax.block_until_ready(calls[name]()))
            seconds[name].append(elapsed / (_FEW if name == ALONE else count))
    return {
        "exact": exact,
        "found": {name: np.asarray(values) for name, values in found.items()},
        "angles": np.degrees(np.arccos(cosine)),
        "seconds": seconds,
    }


def _calls(bodies: tuple[ConvexBody, ConvexBody], poses: tuple[Any, Any]) -> dict[str, Callable[[], Any]]:
    """What is timed of ours. All but the last take all pairs at once."""
    import jax
    import jaxlie

    from regrasp_planner import separation, signed_distance

    (a, b), (pose_a, pose_b) = bodies, poses

    def total(both: tuple[Any, Any], first: ConvexBody, second: ConvexBody) -> tuple[Any, Any]:
        found = separation(first, both[0], second, both[1])
        return found.distance.sum(), found

    graded = jax.jit(jax.grad(total, has_aux=True))
    singles = [(a[k], jaxlie.SE3(pose_a[k]), b[k], jaxlie.SE3(pose_b[k])) for k in range(min(_FEW, len(pose_a)))]
    return {
        DSF: lambda: separation(a, pose_a, b, pose_b).distance,
        GRADIENT: lambda: graded((pose_a, pose_b), a, b),
        QUICK: lambda: separation(a, pose_a, b, pose_b, thorough=False).distance,
        ALONE: lambda: [signed_distance(*single) for single in singles],
    }


def _coal(pairs: Pairs) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, "N 3"], Callable[[], None]]:
    """Exact signed distances, normals from the first body to the second, and what is timed."""
    coal: Any = import_peer("coal")

    def placed(pose: Float[np.ndarray, " 7"]) -> Any:
        return coal.Transform3s(Rotation.from_quat(pose[:4], scalar_first=True).as_matrix(), pose[4:])

    shapes = [(polytope(a), polytope(b)) for a, b in zip(pairs.vertices_a, pairs.vertices_b, strict=True)]
    poses = [(placed(a), placed(b)) for a, b in zip(pairs.poses_a, pairs.poses_b, strict=True)]
    # With the shapes, which coal does not keep alive.
    jobs = [(coal.ComputeDistance(*both), *at, both) for both, at in zip(shapes, poses, strict=True)]
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.enable_signed_distance = True

    def run(found: list[tuple[float, np.ndarray]] | None = None) -> None:
        for measure, first, second, _ in jobs:
            result.clear()
            value = measure(first, second, request, result)
            if found is not None:
                found.append((value, np.array(result.normal)))

    found: list[tuple[float, np.ndarray]] = []
    run(found)
    values, normals = zip(*found, strict=True)
    return np.array(values), np.array(normals), run


# --- what is shown ----------------------------------------------------------------------------------------------------


def _show(report: Record) -> None:
    console = Console()
    table = Table("vertices", "pairs", "", "too large", "short: mean", "99 %", "largest", title="error in mm")
    for vertices, row in report["vertices"].items():
        for group in ("apart", "overlapping"):
            for i, name in enumerate(name for name in (DSF, CERTIFIED, THINNED) if name in row[group]):
                errors = row[group][name]
                table.add_row(
                    vertices if i == 0 and group == "apart" else "",
                    f"{row[group]['pairs']} {group}" if i == 0 else "",
                    name,
                    *(f"{1e3 * errors[key]:.4f}" for key in ("largest_excess", "short_mean", "short_p99", "short_max")),
                )
    console.print(table)
    names = list(dict.fromkeys(name for row in report["vertices"].values() for name in row["seconds_per_pair"]))
    table = Table("µs per pair", *report["vertices"], title=f"median of {report['rounds']} turns")
    for name in names:
        times = (row["seconds_per_pair"].get(name) for row in report["vertices"].values())
        table.add_row(name, *(NOTHING if seconds is None else f"{1e6 * seconds:.2f}" for seconds in times))
    console.print(table)
    for vertices, row in report["vertices"].items():
        angles = row["normal_degrees"]
        console.print(
            f"{vertices} vertices: normals of pairs apart {angles['median']:.3f}° from coal's, 99 % within "
            f"{angles['p99']:.2f}°",
            highlight=False,
        )
    print_crashes(report["crashed"], "vertices")


def _paint(_: Record, ended: Sequence[Record], errors: Axes, times: Axes) -> None:
    whole = completed(ended)
    series: dict[str, Float[np.ndarray, " N"]] = {}
    for record in whole:
        exact = np.array(record["exact"])
        short = exact - np.array(record["found"][DSF])
        for group, chosen in (("apart", exact > 0), ("overlapping", exact <= 0)):
            # The axis is logarithmic; errors below 0.1 µm are drawn as that.
            series[f"{record['trial']} vertices, {group}"] = 1e3 * np.maximum(short[chosen], 1e-7)
    cumulative_shares(errors, series, "distance short of the exact one, mm")
    errors.set_title("signed distance of the DSF, p = 512")
    shown = {
        name: [1e6 * float(np.median(record["seconds"][name])) for record in whole] for name in (DSF, GRADIENT, COAL)
    }
    bars(times, [f"{record['trial']} vertices" for record in whole], shown, (OURS, OURS_LIGHT, PEER))
    times.set_ylabel("µs per pair")
    times.set_title("time, batched; coal pair by pair, without gradients")
