"""PathPlan beside RRT-Connect: the same queries, and the same judge of collisions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from jaxtyping import Float
from rich.console import Console
from rich.table import Table

import regrasp_gym
from regrasp_bench.options import PlotOptions, SceneOptions
from regrasp_bench.peers.coal_checker import ExactChecker
from regrasp_bench.peers.ompl_rrt import polyline, rrt_connect
from regrasp_bench.peers.optional import import_peer
from regrasp_bench.tables.benchmark import Presentation, run_benchmark
from regrasp_bench.tables.path_queries import KINDS, CartesianPath, KindedQuery, planner_queries, random_queries
from regrasp_bench.tables.summary import NOTHING, median, milliseconds, queries_of, seed_range
from regrasp_gym.reports.plots import OURS, PEER, PEER_LIGHT, cumulative_shares
from regrasp_gym.reports.report import Record, package_versions
from regrasp_gym.reports.trials import crashes, print_crashes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from regrasp_planner import Trajectory
    from regrasp_planner.path.query import PathQuery

_TOUCH = 2e-4
"""How much deeper (metres) than at the grasp a contact may become on a straight line."""


@dataclass(frozen=True, kw_only=True)
class PathOptions(SceneOptions, PlotOptions):
    """Compare PathPlan with OMPL's RRT-Connect. Coal checks every path of both, at each centimetre and degree.

    The queries are all that the planner asks while it plans the scenes, answered or not, and random pairs of free
    configurations between which the straight line is blocked, with an empty gripper and with the target in it.
    """

    strategy: str = "repeated"
    """Strategy with which the scenes are planned."""
    random_pairs: int = 3
    """Random queries per scene of each kind, with an empty gripper and with the target in it."""
    time_limit: float = 10.0
    """Time limit of RRT-Connect, seconds per query."""
    records: Path = Path("outputs/bench/path.jsonl")


def path(options: PathOptions) -> int:
    """Run the benchmark; returns the exit code."""
    packages = ("regrasp-gym", "jax", "numpy", "scipy", "mujoco", "coal", "ompl")
    setting = options.values("env", "strategy", "random_pairs", "time_limit")
    setting |= {"versions": package_versions(("regrasp-gym", "coal", "ompl"))}
    return run_benchmark(options, setting, options.seeds, _prepare, summarise, Presentation(_show, _paint, 2, packages))


def summarise(setting: Record, scenes: Sequence[Record]) -> Record:
    """Successes, times, lengths and collisions by kind of query."""
    queries = queries_of(scenes)
    collisions = [
        {"seed": query["seed"], "number": query["number"], "planner": name, "bodies": query[name]["collisions"]}
        for query in queries
        for name in ("ours", "rrt")
        if name in query and query[name]["collisions"]
    ]
    lines = [line for scene in scenes for line in scene.get("lines", ())]
    return {
        **setting,
        "seeds": seed_range(scenes),
        "kinds": {kind: _compared([query for query in queries if query["kind"] == kind]) for kind in KINDS},
        "collisions": collisions,
        "lines": {
            "count": len(lines),
            "touching_at_grasp": sum(line["touching"] > 0 for line in lines),
            "in_collision": [line["collisions"] for line in lines if line["collisions"]],
        },
        "crashed": crashes(scenes),
    }


def _compared(queries: Sequence[Record]) -> Record:
    """Figures of both planners for queries of one kind."""
    kept = [query for query in queries if query["free_ends"]]
    found = [(query, query["ours"]["success"], query["rrt"]["success"]) for query in kept]
    return {
        "queries": len(kept),
        "left_out": len(queries) - len(kept),
        "left_out_answered": sum(query["ours"]["success"] for query in queries if not query["free_ends"]),
        "ours": _figures([query["ours"] for query in kept]),
        "rrt": _figures([query["rrt"] for query in kept]),
        "length_ratio_median": median(
            [query["ours"]["length"] / query["rrt"]["length"] for query, ours, rrt in found if ours and rrt]
        ),
        "only_rrt": [(query["seed"], query["number"]) for query, ours, rrt in found if rrt and not ours],
        "only_ours": [(query["seed"], query["number"]) for query, ours, rrt in found if ours and not rrt],
    }


def _figures(answers: Sequence[Record]) -> Record:
    found = [answer for answer in answers if answer["success"]]
    seconds = [answer["seconds"] for answer in answers]
    figures: Record = {
        "success": len(found),
        "free_of_collisions": sum(not answer["collisions"] for answer in found),
        "seconds_median": median(seconds),
        "seconds_p90": float(np.quantile(seconds, 0.9)) if seconds else None,
        "length_median": median([answer["length"] for answer in found]),
    }
    if found and "simplify_seconds" in found[0]:
        figures["simplify_seconds_median"] = median([answer["simplify_seconds"] for answer in found])
        figures["checked_median"] = median([answer["checked"] for answer in found])
    return figures


# --- trials -----------------------------------------------------------------------------------------------------------


def _prepare(setting: Record) -> Callable[[int], Record]:
    for module in ("coal", "ompl.geometric"):
        import_peer(module)
    env = gymnasium.make(setting["env"])
    inner = regrasp_gym.PlannerExpert(env).env

    def run(seed: int) -> Record:
        env.reset(seed=seed)
        queries, lines = planner_queries(inner, setting["strategy"])
        rng = np.random.default_rng(seed)
        queries += random_queries(inner.task(), inner.planner_robot, setting["random_pairs"], rng)
        return {
            "queries": [
                _compare(query, setting["time_limit"], ours_first=k % 2 == 0) for k, query in enumerate(queries)
            ],
            "lines": [_check_line(line) for line in lines],
        }

    return run


def _compare(kinded: KindedQuery, time_limit: float, ours_first: bool) -> Record:
    kind, query = kinded
    checker = ExactChecker(query.space.model, query.space.theta)
    free = checker.free(np.stack([query.start, query.goal]))
    record: Record = {"kind": kind, "free_ends": free}
    planners = {"ours": partial(_ours, query, checker), "rrt": partial(_rrt, query, checker, time_limit)}
    for name in ("ours", "rrt") if ours_first else ("rrt", "ours"):
        # RRT-Connect needs free ends. What PathPlan does with others shows in its own collisions.
        if free or name == "ours":
            record[name] = planners[name]()
    return record


def _check_line(line: CartesianPath) -> Record:
    """Collisions on a straight line. The end at the grasp may be in contact; no contact may become deeper than that."""
    checker = ExactChecker(line.space.model, line.space.theta)
    touching = np.maximum(-checker.clearances(line.trajectory.start[None])[0], 0.0)
    allowed = np.where(touching > 0, touching + _TOUCH, 0.0)
    collisions = checker.collisions(_by_share(line.trajectory), allowed)
    return {"touching": float(touching.max()), "collisions": collisions}


def _ours(query: PathQuery, checker: ExactChecker) -> Record:
    from regrasp_planner.path.path_plan import plan_path

    solve = partial(plan_path, query)
    # The first call compiles. Both have the same result, but for the times.
    solve()
    result = solve()
    record: Record = {"success": result.success, "seconds": result.stats["seconds"], "status": result.status.name}
    record |= {"method": result.stats.get("method", ""), "length": None, "collisions": []}
    if result.trajectory is not None:
        record |= _judge(_by_share(result.trajectory), checker)
        record["duration"] = result.trajectory.duration
    return record


def _rrt(query: PathQuery, checker: ExactChecker, time_limit: float) -> Record:
    result = rrt_connect(checker, query.start, query.goal, time_limit)
    record: Record = {"success": result.waypoints is not None, "seconds": result.seconds}
    record |= {"simplify_seconds": result.simplify_seconds, "checked": result.checked, "length": None, "collisions": []}
    if result.waypoints is not None:
        record |= _judge(polyline(result.waypoints), checker)
    return record


def _judge(course: Callable[[Any], Any], checker: ExactChecker) -> Record:
    length = np.linalg.norm(np.diff(course(np.linspace(0.0, 1.0, 2001)), axis=0), axis=1).sum()
    return {"length": float(length), "collisions": checker.collisions(course)}


def _by_share(trajectory: Trajectory) -> Callable[[Float[np.ndarray, " N"]], Float[np.ndarray, "N n"]]:
    """The trajectory as a function of the share of its duration, 0 to 1."""
    return lambda u: trajectory.at(trajectory.times[0] + u * trajectory.duration)


# --- what is shown ----------------------------------------------------------------------------------------------------


def _show(summary: Record) -> None:
    columns = ("queries", "planner", "found", "no collision", "ms", "p90", "simplify", "length")
    table = Table(*columns, title=f"path queries of scenes {summary['seeds']}")
    for kind, figures in summary["kinds"].items():
        label = f"{figures['queries']} {kind}"
        for key, name in (("ours", "PathPlan"), ("rrt", "RRTConnect")):
            row = figures[key]
            times = [row.get(part) for part in ("seconds_median", "seconds_p90", "simplify_seconds_median")]
            table.add_row(
                label,
                name,
                str(row["success"]),
                str(row["free_of_collisions"]),
                *(milliseconds(seconds, 0) for seconds in times),
                NOTHING if row["length_median"] is None else f"{row['length_median']:.2f}",
            )
            label = ""
    console = Console(highlight=False)
    console.print(table)
    console.print("times: median and 90 % per query, found or not; length: median, radians")
    for kind, figures in summary["kinds"].items():
        if figures["left_out"]:
            console.print(
                f"{kind}: {figures['left_out']} left out because an end is in collision; "
                f"PathPlan answers {figures['left_out_answered']} of them"
            )
        if figures["only_rrt"]:
            console.print(f"{kind}: only RRTConnect finds (seed, query) {figures['only_rrt']}")
    depths: list[float] = []
    for collision in summary["collisions"]:
        if collision["planner"] == "ours":
            console.print(f"PathPlan in collision: {collision}", style="red", markup=False)
        else:
            depths.append(collision["bodies"][0][2])
    lines = summary["lines"]
    console.print(
        f"straight lines: {lines['count']}, {len(lines['in_collision'])} of them in collision; "
        f"{lines['touching_at_grasp']} begin in contact"
    )
    if depths:
        console.print(
            f"RRTConnect: {len(depths)} paths collide between its checks, by up to {1e3 * max(depths):.1f} mm"
        )
    print_crashes(summary["crashed"])


def _paint(_: Record, scenes: Sequence[Record], *panels: Axes) -> None:
    free = [query for query in queries_of(scenes) if query["free_ends"]]
    for axes, word in zip(panels, ("planned", "random"), strict=True):
        queries = [query for query in free if query["kind"].startswith(word)]

        def seconds(name: str, queries: Sequence[Record] = queries) -> Float[np.ndarray, " N"]:
            return np.array([query[name]["seconds"] if query[name]["success"] else np.inf for query in queries])

        simplify = np.array([query["rrt"]["simplify_seconds"] for query in queries])
        series = {
            "PathPlan": seconds("ours"),
            "RRTConnect": seconds("rrt"),
            "RRTConnect, simplified": seconds("rrt") + simplify,
        }
        cumulative_shares(axes, series, "seconds per query", (OURS, PEER, PEER_LIGHT))
        axes.set_title(f"{word} queries")
