"""IkSolve beside mink, on gripper poses that are known to have a collision-free configuration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import gymnasium
import numpy as np
from jaxtyping import Float
from rich.console import Console
from rich.table import Table

import regrasp_gym
from regrasp_bench.options import PlotOptions, SceneOptions
from regrasp_bench.peers.mink_ik import MinkPeer, exhaustive_search, is_at_target
from regrasp_bench.tables.benchmark import Presentation, run_benchmark
from regrasp_bench.tables.ik_queries import KINDS, IkQuery, grasp_queries, random_queries
from regrasp_bench.tables.summary import median_and_p90, milliseconds, percent, queries_of, seed_range
from regrasp_bench.tables.timing import least_seconds, mean_seconds
from regrasp_gym.reports.plots import OURS, OURS_LIGHT, PEER, cumulative_shares
from regrasp_gym.reports.report import Record, package_versions, wilson
from regrasp_gym.reports.trials import crashes, print_crashes

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, kw_only=True)
class IkOptions(SceneOptions, PlotOptions):
    """Compare IkSolve with mink. Independent kinematics and collision checks by coal judge the answers of both.

    The poses are those of random configurations that keep all margins, anywhere and close to an obstacle, and those of
    grasps for which a search from 4096 random starts finds such a configuration.
    """

    random_poses: int = 8
    """Random poses per scene of each kind, anywhere and close to an obstacle."""
    grasps: int = 4
    """Grasps per scene at the pick, and at the place."""
    starts: int = 256
    """Starts of mink, one after another until one ends free of collisions. IkSolve has 256 at a time."""
    records: Path = Path("outputs/bench/ik.jsonl")


def ik(options: IkOptions) -> int:
    """Run the benchmark; returns the exit code."""
    setting = options.values("env", "random_poses", "grasps", "starts")
    setting["versions"] = package_versions(("regrasp-gym", "coal", "mink"))
    packages = ("regrasp-gym", "jax", "numpy", "scipy", "mujoco", "coal", "mink", "daqp")
    return run_benchmark(
        options, setting, options.seeds, _prepare, summarise, Presentation(_show, _paint, packages=packages)
    )


def summarise(setting: Record, scenes: Sequence[Record]) -> Record:
    """Successes and times by kind of pose, and of all together."""
    queries = queries_of(scenes)
    kinds: Record = {}
    for kind in (*KINDS, "all"):
        of_kind = [query for query in queries if kind in (query["kind"], "all")]
        kept = [query for query in of_kind if query["solvable"]]
        missed = [query for query in kept if not query["ours"]["solved"]]
        kinds[kind] = {
            "poses": len(kept),
            "left_out": len(of_kind) - len(kept),
            "ours": _figures([query["ours"] for query in kept]),
            "mink": _figures([query["mink"] for query in kept]),
            "missed": [(query["seed"], query["number"], query["ours"]["message"]) for query in missed],
        }
    return {**setting, "seeds": seed_range(scenes), "kinds": kinds, "crashed": crashes(scenes)}


def _figures(answers: Sequence[Record]) -> Record:
    if not answers:
        return {"solved": 0}
    solved = sum(answer["solved"] for answer in answers)
    figures: Record = {
        "solved": solved,
        "share": solved / len(answers),
        "share_95": wilson(solved, len(answers)),
        "wrong": sum(answer["found"] and not answer["solved"] for answer in answers),
        **median_and_p90([answer["seconds"] for answer in answers], "seconds_"),
    }
    if "seconds_in_batch" in answers[0]:
        figures["seconds_in_batch_median"] = float(np.median([answer["seconds_in_batch"] for answer in answers]))
    if "first_reached" in answers[0]:
        figures["first_start_share"] = float(np.mean([answer["first_reached"] for answer in answers]))
        figures["starts_mean"] = float(np.mean([answer["starts"] for answer in answers]))
    return figures


# --- trials -----------------------------------------------------------------------------------------------------------


def _prepare(setting: Record) -> Callable[[int], Record]:
    made = gymnasium.make(setting["env"])
    inner = regrasp_gym.PlannerExpert(made).env
    mink = MinkPeer(inner.scenario)

    def run(seed: int) -> Record:
        made.reset(seed=seed)
        task, robot = inner.task(), inner.planner_robot
        rng = np.random.default_rng(seed)
        queries = random_queries(task, robot, setting["random_poses"], rng)
        solvable = [True] * len(queries)
        grasps = grasp_queries(task, robot, setting["grasps"])
        solvable += [exhaustive_search(query.checker, query.matrix, rng) is not None for query in grasps]
        queries += grasps
        limits = np.asarray(robot.arm.lower, float), np.asarray(robot.arm.upper, float)
        starts = np.vstack([np.asarray(robot.home), rng.uniform(*limits, (setting["starts"] - 1, robot.arm.dof))])
        answers: list[Record] = []
        for k, query in enumerate(queries):
            record: Record = {"kind": query.kind, "solvable": solvable[k]}
            solvers = {"ours": partial(_ours, query), "mink": partial(_mink, mink, query, starts)}
            for name in ("ours", "mink") if k % 2 == 0 else ("mink", "ours"):
                record[name] = solvers[name]()
            answers.append(record)
        _add_batch_seconds(queries, answers)
        return {"queries": answers}

    return run


def _ours(query: IkQuery) -> Record:
    from regrasp_planner.ik.ik_solve import solve_ik

    solve = partial(solve_ik, query.model, query.target[None], query.theta)
    seconds, (result,) = least_seconds({"ours": solve})["ours"]
    record: Record = {"found": result.success, "seconds": seconds, "message": result.message}
    return record | {"solved": result.success and _solves(query, result.q), "solutions": len(result.solutions)}


def _mink(mink: MinkPeer, query: IkQuery, starts: Float[np.ndarray, "S n"]) -> Record:
    result = mink.solve(query.checker, query.matrix, starts)
    record: Record = {"found": result.q is not None, "seconds": result.seconds, "starts": result.starts}
    record |= {"reached": result.reached, "first_reached": result.first_reached}
    return record | {"solved": result.q is not None and _solves(query, result.q)}


def _add_batch_seconds(queries: Sequence[IkQuery], answers: Sequence[Record]) -> None:
    """Add the time per pose if IkSolve solves all poses of a collision model at once, as the planner does."""
    from regrasp_planner.ik.ik_solve import solve_ik

    for model in {id(query.model): query.model for query in queries}.values():
        mine = [i for i, query in enumerate(queries) if query.model is model]
        targets = np.stack([queries[i].target for i in mine])
        solve = partial(solve_ik, model, targets, np.array([queries[i].theta for i in mine]))
        solve()
        seconds = mean_seconds(solve)
        for i in mine:
            answers[i]["ours"]["seconds_in_batch"] = seconds / len(mine)


def _solves(query: IkQuery, q: Float[np.ndarray, " n"]) -> bool:
    """Whether an answer is at the target, within the limits and free of collisions."""
    checker = query.checker
    within = (q >= checker.lower - 1e-6).all() and (q <= checker.upper + 1e-6).all()
    return bool(within) and is_at_target(checker, q, query.matrix) and checker.free(q[None])


# --- what is shown ----------------------------------------------------------------------------------------------------


def _show(summary: Record) -> None:
    columns = ("poses", "solver", "solved", "% (95 %)", "ms", "p90", "batch")
    table = Table(*columns, title=f"inverse kinematics, scenes {summary['seeds']}")
    for kind, figures in summary["kinds"].items():
        if not figures["poses"]:
            continue
        label = f"{figures['poses']} {kind}"
        for key, name in (("ours", "IkSolve"), ("mink", "mink")):
            row = figures[key]
            times = [row["seconds_median"], row["seconds_p90"], row.get("seconds_in_batch_median")]
            share = percent(row["solved"], figures["poses"], row["share_95"], 1, 1)
            table.add_row(label, name, str(row["solved"]), share, *(milliseconds(seconds, 1) for seconds in times))
            label = ""
    console = Console()
    console.print(table)
    console.print("times per pose: median and 90 %; batch: all poses of a scene at once", highlight=False)
    together = summary["kinds"]["all"]
    if together["left_out"]:
        message = f"{together['left_out']} grasps left out: no configuration is known that keeps all margins"
        console.print(message, highlight=False)
    for seed, number, message in together["missed"]:
        console.print(f"IkSolve missed seed {seed}, pose {number}: {message}", markup=False, highlight=False)
    print_crashes(summary["crashed"])


def _paint(_: Record, scenes: Sequence[Record], axes: Axes) -> None:
    queries = [query for query in queries_of(scenes) if query["solvable"]]

    def seconds(name: str, part: str = "seconds") -> Float[np.ndarray, " N"]:
        return np.array([query[name][part] if query[name]["solved"] else np.inf for query in queries])

    series = {
        "IkSolve": seconds("ours"),
        "IkSolve, all poses of a scene at once": seconds("ours", "seconds_in_batch"),
        "mink, start after start": seconds("mink"),
    }
    cumulative_shares(axes, series, "seconds per pose", (OURS, OURS_LIGHT, PEER))
    axes.set_title("poses solved, free of collisions")
