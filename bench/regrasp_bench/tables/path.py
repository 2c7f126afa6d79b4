"""PathPlan beside RRT-Connect: the same queries, the same judge of collisions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import gymnasium
import numpy as np
import tyro
from jaxtyping import Float
from rich.console import Console
from rich.table import Table

import regrasp_gym
from regrasp_bench.peers.coal_checker import ExactChecker
from regrasp_bench.peers.ompl_rrt import polyline, rrt_connect
from regrasp_bench.tables.path_queries import KINDS, Line, Query, asked, random_queries
from regrasp_gym.reports.plots import OURS, PEER, PEER_TOO, check_format, draw, shares
from regrasp_gym.reports.trials import Record, crashes, peer, run_trials, write_report

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from regrasp_planner import Trajectory

_TOUCH = 2e-4
"""How much deeper (metres) than at the grasp what is in contact there may get on a straight line."""
_PACKAGES = ("regrasp-gym", "jax", "numpy", "scipy", "mujoco", "coal", "ompl")


def path(
    env: str = "regrasp_gym/PandaYCB-v0",
    scenes: int = 50,
    first_seed: int = 0,
    strategy: str = "repeated",
    random_pairs: int = 3,
    time_limit: float = 10.0,
    workers: int = 1,
    records: Path = Path("outputs/bench/path.jsonl"),
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    plot_file: Annotated[Path | None, tyro.conf.arg(name="plot")] = None,
) -> None:
    """Compare PathPlan with OMPL's RRT-Connect, and check every path of both with coal, each cm and degree.

    The queries are all that the planner asks while it plans the scenes, answered or not, and random pairs of free
    configurations between which the straight line is blocked, with an empty hand and with the target in it.

    Args:
        env: id of the environment whose scenes are used.
        scenes: how many.
        first_seed: seed of the first scene.
        strategy: with which the scenes are planned.
        random_pairs: random queries per scene, of either kind.
        time_limit: of RRT-Connect, seconds per query.
        workers: processes; with more than one the times are not to be trusted.
        records: one JSON line per scene, appended as they end.
        json_file: write the summary as JSON.
        plot_file: draw the times (.svg, .png or .pdf).
    """
    check_format(plot_file)
    setting: Record = {"env": env, "strategy": strategy, "random_pairs": random_pairs, "time_limit": time_limit}
    setting["versions"] = {name: version(name) for name in ("regrasp-gym", "coal", "ompl")}
    seeds = range(first_seed, first_seed + scenes)
    ended = run_trials(setting, seeds, _prepare, workers=workers, records=records, label="scenes")
    report = summarise(setting, ended)
    _show(report)
    write_report(json_file, report, _PACKAGES)
    draw(plot_file, partial(_paint, ended), panels=2)


def summarise(setting: Record, scenes: Sequence[Record]) -> Record:
    """Successes, times, lengths and collisions by kind of query."""
    queries: list[Record] = [
        {"seed": scene["trial"], "number": i, **query}
        for scene in scenes
        for i, query in enumerate(scene.get("queries", ()))
    ]
    kinds: Record = {}
    for kind in KINDS:
        asked = [query for query in queries if query["kind"] == kind]
        kept = [query for query in asked if query["free_ends"]]
        both = [query for query in kept if query["ours"]["success"] and query["rrt"]["success"]]
        kinds[kind] = {
            "queries": len(kept),
            "left_out": len(asked) - len(kept),
            "left_out_answered": sum(query["ours"]["success"] for query in asked if not query["free_ends"]),
            "ours": _figures([query["ours"] for query in kept]),
            "rrt": _figures([query["rrt"] for query in kept]),
            "length_ratio_median": _median([q["ours"]["length"] / q["rrt"]["length"] for q in both]),
            "only_rrt": [(q["seed"], q["number"]) for q in kept if q["rrt"]["success"] and not q["ours"]["success"]],
            "only_ours": [(q["seed"], q["number"]) for q in kept if q["ours"]["success"] and not q["rrt"]["success"]],
        }
    collisions = [
        {"seed": query["seed"], "number": query["number"], "planner": name, "bodies": query[name]["collisions"]}
        for query in queries
        for name in ("ours", "rrt")
        if name in query and query[name]["collisions"]
    ]
    lines = [line for scene in scenes for line in scene.get("lines", ())]
    return {
        **setting,
        "seeds": [scenes[0]["trial"], scenes[-1]["trial"]] if scenes else [],
        "kinds": kinds,
        "collisions": collisions,
        "lines": {
            "count": len(lines),
            "touching_at_grasp": sum(line["touching"] > 0 for line in lines),
            "in_collision": [line["collisions"] for line in lines if line["collisions"]],
        },
        "crashed": crashes(scenes),
    }


# --- trials -----------------------------------------------------------------------------------------------------------


def _prepare(setting: Record) -> Callable[[int], Record]:
    for module in ("coal", "ompl.geometric"):
        peer(module)
    made = gymnasium.make(setting["env"])
    inner = regrasp_gym.PlannerExpert(made).env

    def run(seed: int) -> Record:
        made.reset(seed=seed)
        task, robot = inner.task(), inner.planner_robot
        rng = np.random.default_rng(seed)
        queries, lines = asked(inner, setting["strategy"])
        queries += random_queries(task, robot, setting["random_pairs"], rng)
        limit = setting["time_limit"]
        return {
            "queries": [_compare(query, limit, ours_first=k % 2 == 0) for k, query in enumerate(queries)],
            "lines": [_line(line) for line in lines],
        }

    return run


def _compare(query: Query, time_limit: float, ours_first: bool) -> Record:
    checker = ExactChecker(query.space.model, query.space.theta)
    free = checker.free(np.stack([query.start, query.goal]))
    record: Record = {"kind": query.kind, "free_ends": free}
    turns = {"ours": partial(_ours, query, checker), "rrt": partial(_rrt, query, checker, time_limit)}
    for name in ("ours", "rrt") if ours_first else ("rrt", "ours"):
        # RRT-Connect has no use for an end in collision; what PathPlan makes of it shows in its own collisions.
        if free or name == "ours":
            record[name] = turns[name]()
    return record


def _line(line: Line) -> Record:
    """Collisions of a straight line; the end at the grasp may be in contact already, and no deeper than it is there."""
    checker = ExactChecker(line.space.model, line.space.theta)
    touching = np.maximum(-checker.clearances(line.trajectory.start[None])[0], 0.0)
    allowed = np.where(touching > 0, touching + _TOUCH, 0.0)
    return {
        "touching": float(touching.max()),
        "collisions": checker.collisions(_of_trajectory(line.trajectory), allowed),
    }


def _ours(query: Query, checker: ExactChecker) -> Record:
    from regrasp_planner.path.path_plan import plan_path

    answer = partial(plan_path, query.space, query.start, query.goal, query.options)
    # The first call compiles what has not been; the answer is the same.
    answer()
    result = answer()
    record: Record = {"success": result.success, "seconds": result.stats["seconds"], "status": result.status.name}
    record |= {"method": result.stats.get("method", ""), "length": None, "collisions": []}
    if result.trajectory is not None:
        record |= _judged(_of_trajectory(result.trajectory), checker)
        record["duration"] = result.trajectory.duration
    return record


def _rrt(query: Query, checker: ExactChecker, time_limit: float) -> Record:
    limits = query.space.lower, query.space.upper
    result = rrt_connect(checker, query.start, query.goal, *limits, time_limit)
    record: Record = {"success": result.waypoints is not None, "seconds": result.seconds}
    record |= {"simplify_seconds": result.simplify_seconds, "checked": result.checked, "length": None, "collisions": []}
    if result.waypoints is not None:
        record |= _judged(polyline(result.waypoints), checker)
    return record


def _judged(course: Callable[[Any], Any], checker: ExactChecker) -> Record:
    length = np.linalg.norm(np.diff(course(np.linspace(0.0, 1.0, 2001)), axis=0), axis=1).sum()
    return {"length": float(length), "collisions": checker.collisions(course)}


def _of_trajectory(trajectory: Trajectory) -> Callable[[Float[np.ndarray, " N"]], Float[np.ndarray, "N n"]]:
    return lambda u: trajectory.at(trajectory.times[0] + u * trajectory.duration)


# --- what is shown ----------------------------------------------------------------------------------------------------


def _figures(answers: Sequence[Record]) -> Record:
    found = [answer for answer in answers if answer["success"]]
    seconds = [answer["seconds"] for answer in answers]
    figures: Record = {
        "success": len(found),
        "free_of_collisions": sum(not answer["collisions"] for answer in found),
        "seconds_median": _median(seconds),
        "seconds_p90": float(np.quantile(seconds, 0.9)) if seconds else None,
        "length_median": _median([answer["length"] for answer in found]),
    }
    if found and "simplify_seconds" in found[0]:
        figures["simplify_seconds_median"] = _median([answer["simplify_seconds"] for answer in found])
        figures["checked_median"] = _median([answer["checked"] for answer in found])
    return figures


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) else None


def _show(report: Record) -> None:
    columns = ("queries", "planner", "found", "no collision", "ms", "p90", "simplify", "length")
    table = Table(*columns, title=f"path queries of scenes {report['seeds']}")
    for kind, figures in report["kinds"].items():
        for i, (key, name) in enumerate((("ours", "PathPlan"), ("rrt", "RRTConnect"))):
            row = figures[key]
            label = f"{figures['queries']} {kind}" if i == 0 else ""
            table.add_row(
                label,
                name,
                str(row["success"]),
                str(row["free_of_collisions"]),
                *(
                    _milliseconds(row.get(part))
                    for part in ("seconds_median", "seconds_p90", "simplify_seconds_median")
                ),
                "–" if row["length_median"] is None else f"{row['length_median']:.2f}",
            )
    console = Console()
    console.print(table)
    console.print("times: median and 90 % per query, found or not; length: median, radians", highlight=False)
    for kind, figures in report["kinds"].items():
        if figures["left_out"]:
            message = f"{kind}: {figures['left_out']} left out, an end in collision already; "
            message += f"{figures['left_out_answered']} of these PathPlan answers nevertheless"
            console.print(message, highlight=False)
        if figures["only_rrt"]:
            console.print(f"{kind}: only RRTConnect finds (seed, query) {figures['only_rrt']}", highlight=False)
    for collision in report["collisions"]:
        if collision["planner"] == "ours":
            console.print(f"PathPlan in collision: {collision}", style="red", markup=False, highlight=False)
    lines = report["lines"]
    message = f"straight lines: {lines['count']}, {len(lines['in_collision'])} of them in collision"
    console.print(f"{message}; {lines['touching_at_grasp']} begin in contact", highlight=False)
    depths = [collision["bodies"][0][2] for collision in report["collisions"] if collision["planner"] == "rrt"]
    if depths:
        message = f"RRTConnect: {len(depths)} paths collide between its checks, {1e3 * max(depths):.1f} mm at most"
        console.print(message, highlight=False)
    for error, seeds in report["crashed"].items():
        console.print(f"crashed: {error}, seeds {seeds}", style="red", markup=False, highlight=False)


def _milliseconds(seconds: float | None) -> str:
    return "–" if seconds is None else f"{1e3 * seconds:.0f}"


def _paint(scenes: Sequence[Record], *panels: Axes) -> None:
    for axes, word in zip(panels, ("planned", "random"), strict=True):
        queries = [
            q for scene in scenes for q in scene.get("queries", ()) if q["kind"].startswith(word) and q["free_ends"]
        ]
        ours = [q["ours"]["seconds"] if q["ours"]["success"] else np.inf for q in queries]
        search = [q["rrt"]["seconds"] if q["rrt"]["success"] else np.inf for q in queries]
        both = [q["rrt"]["simplify_seconds"] + s for q, s in zip(queries, search, strict=True)]
        series = {"PathPlan": ours, "RRTConnect": search, "RRTConnect, simplified": both}
        shares(
            axes,
            {name: np.array(values) for name, values in series.items()},
            "seconds per query",
            (OURS, PEER, PEER_TOO),
        )
        axes.set_title(f"{word} queries")
