"""IkSolve beside mink, on gripper poses that are known to have a collision-free configuration."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import gymnasium
import numpy as np
import tyro
from jaxtyping import Float
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

import regrasp_gym
from regrasp_bench.peers.coal_checker import ExactChecker
from regrasp_bench.peers.mink_ik import MinkPeer, exhaustive_search, reaches
from regrasp_gym.reports.plots import OURS, OURS_TOO, PEER, check_format, draw, shares
from regrasp_gym.reports.trials import Record, crashes, run_trials, wilson, write_report

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from regrasp_planner import Robot, Task
    from regrasp_planner.collision.model import CollisionModel

KINDS = ("random", "random, close", "grasp at pick", "grasp at place")
CLOSE = 0.02
"""Clearance (metres) below which a random configuration counts as close to something."""
_PACKAGES = ("regrasp-gym", "jax", "numpy", "scipy", "mujoco", "coal", "mink", "daqp")


@dataclass(frozen=True)
class Query:
    """A gripper pose to reach.

    Attributes:
        kind: one of `KINDS`.
        model: what may be hit.
        checker: the same for coal.
        target: (7,) pose of the gripper in the world, wxyz_xyz.
        theta: finger coordinate.
    """

    kind: str
    model: CollisionModel
    checker: ExactChecker
    target: Float[np.ndarray, " 7"]
    theta: float


def ik(
    env: str = "regrasp_gym/PandaYCB-v0",
    scenes: int = 50,
    first_seed: int = 0,
    random_poses: int = 8,
    grasps: int = 4,
    starts: int = 256,
    workers: int = 1,
    records: Path = Path("outputs/bench/ik.jsonl"),
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
    plot_file: Annotated[Path | None, tyro.conf.arg(name="plot")] = None,
) -> None:
    """Compare IkSolve with mink; answers of both are judged by coal and by kinematics of their own.

    The poses are those of random configurations that keep all margins, anywhere and close to something, and those of
    grasps for which a search from 4096 random starts finds such a configuration.

    Args:
        env: id of the environment whose scenes are used.
        scenes: how many.
        first_seed: seed of the first scene.
        random_poses: random poses per scene, of either kind.
        grasps: grasps per scene, at the pick and at the place.
        starts: of mink, one after another, until one ends free of collisions; IkSolve has 256 at a time.
        workers: processes; with more than one the times are not to be trusted.
        records: one JSON line per scene, appended as they end.
        json_file: write the summary as JSON.
        plot_file: draw the times (.svg, .png or .pdf).
    """
    check_format(plot_file)
    setting: Record = {"env": env, "random_poses": random_poses, "grasps": grasps, "starts": starts}
    setting["versions"] = {name: version(name) for name in ("regrasp-gym", "coal", "mink")}
    seeds = range(first_seed, first_seed + scenes)
    ended = run_trials(setting, seeds, _prepare, workers=workers, records=records, label="scenes")
    report = summarise(setting, ended)
    _show(report)
    write_report(json_file, report, _PACKAGES)
    draw(plot_file, partial(_paint, ended))


def summarise(setting: Record, scenes: Sequence[Record]) -> Record:
    """Successes and times by kind of pose, and of all together."""
    queries: list[Record] = [
        {"seed": scene["trial"], "number": i, **query}
        for scene in scenes
        for i, query in enumerate(scene.get("queries", ()))
    ]
    kinds: Record = {}
    for kind in (*KINDS, "all"):
        asked = [query for query in queries if kind in (query["kind"], "all")]
        kept = [query for query in asked if query["solvable"]]
        lost = [query for query in kept if not query["ours"]["solved"]]
        kinds[kind] = {
            "poses": len(kept),
            "left_out": len(asked) - len(kept),
            "ours": _figures([query["ours"] for query in kept]),
            "mink": _figures([query["mink"] for query in kept]),
            "missed": [(query["seed"], query["number"], query["ours"]["message"]) for query in lost],
        }
    return {
        **setting,
        "seeds": [scenes[0]["trial"], scenes[-1]["trial"]] if scenes else [],
        "kinds": kinds,
        "crashed": crashes(scenes),
    }


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
        known = [True] * len(queries)
        grasps = grasp_queries(task, robot, setting["grasps"])
        limits = np.asarray(robot.arm.lower, float), np.asarray(robot.arm.upper, float)
        known += [exhaustive_search(q.checker, _matrix(q.target), *limits, rng) is not None for q in grasps]
        starts = np.vstack([np.asarray(robot.home), rng.uniform(*limits, (setting["starts"] - 1, robot.arm.dof))])
        found: list[Record] = []
        for k, (query, solvable) in enumerate(zip([*queries, *grasps], known, strict=True)):
            record: Record = {"kind": query.kind, "solvable": solvable}
            turns = {"ours": partial(_ours, query), "mink": partial(_mink, mink, query, starts)}
            for name in ("ours", "mink") if k % 2 == 0 else ("mink", "ours"):
                record[name] = turns[name]()
            found.append(record)
        _batched([*queries, *grasps], found)
        return {"queries": found}

    return run


def random_queries(task: Task, robot: Robot, count: int, rng: np.random.Generator) -> list[Query]:
    """Gripper poses of random configurations that keep all margins: ``count`` anywhere and ``count`` close ones."""
    from regrasp_planner.stages.collision_models import CollisionModels
    from regrasp_planner.stages.options import MotionOptions

    models = CollisionModels(robot, task.target, task.pick.obstacles, MotionOptions())
    model, theta = models.empty_handed(task.pick.target_pose), float(robot.gripper.upper)
    checker = ExactChecker(model, theta)
    lower, upper = np.asarray(robot.arm.lower), np.asarray(robot.arm.upper)
    left = {"random": count, "random, close": count}
    queries: list[Query] = []
    while any(left.values()):
        q = rng.uniform(lower, upper, (1, robot.arm.dof))
        if not checker.keeps_margins(q)[0]:
            continue
        close = bool(checker.clearances(q, cap=CLOSE).min() < CLOSE)
        kind = "random, close" if close and left["random, close"] else "random"
        if left[kind]:
            left[kind] -= 1
            queries.append(Query(kind, model, checker, _pose(checker.frames(q)[0, -2]), theta))
    return queries


def grasp_queries(task: Task, robot: Robot, count: int) -> list[Query]:
    """Gripper poses of ``count`` grasps in the pick scene and as many in the place scene."""
    from regrasp_planner import generate_grasps
    from regrasp_planner.stages.collision_models import CollisionModels
    from regrasp_planner.stages.options import MotionOptions

    models = CollisionModels(robot, task.target, task.pick.obstacles, MotionOptions())
    queries: list[Query] = []
    for kind, scene in (("grasp at pick", task.pick), ("grasp at place", task.place)):
        model = models.empty_handed(scene.target_pose)
        for grasp in generate_grasps(task.target, (scene,), robot.gripper).grasps[:count]:
            target = np.asarray(grasp.gripper_pose(scene.target_pose))
            queries.append(Query(kind, model, ExactChecker(model, float(grasp.opening)), target, float(grasp.opening)))
    return queries


def _ours(query: Query) -> Record:
    from regrasp_planner.ik.ik_solve import solve_ik

    answer = partial(solve_ik, query.model, query.target[None], query.theta)
    # The first call compiles what has not been; the answer is the same.
    answer()
    began = time.perf_counter()
    result = answer()[0]
    seconds = time.perf_counter() - began
    record: Record = {"found": result.success, "seconds": seconds, "message": result.message}
    return record | {"solved": result.success and _holds(query, result.q), "solutions": len(result.solutions)}


def _mink(mink: MinkPeer, query: Query, starts: Float[np.ndarray, "S n"]) -> Record:
    result = mink.solve(query.checker, _matrix(query.target), starts)
    record: Record = {"found": result.q is not None, "seconds": result.seconds, "starts": result.starts}
    record |= {"reached": result.reached, "first_reached": result.first_reached}
    return record | {"solved": result.q is not None and _holds(query, result.q)}


def _batched(queries: Sequence[Query], records: Sequence[Record]) -> None:
    """Seconds per pose where IkSolve is asked for all poses of a scene and hand at once, as the planner does."""
    from regrasp_planner.ik.ik_solve import solve_ik

    for model in {id(query.model): query.model for query in queries}.values():
        mine = [i for i, query in enumerate(queries) if query.model is model]
        targets = np.stack([queries[i].target for i in mine])
        answer = partial(solve_ik, model, targets, np.array([queries[i].theta for i in mine]))
        answer()
        began = time.perf_counter()
        answer()
        for i in mine:
            records[i]["ours"]["seconds_in_batch"] = (time.perf_counter() - began) / len(mine)


def _holds(query: Query, q: Float[np.ndarray, " n"]) -> bool:
    """Whether an answer is at the target, within the limits and free of collisions."""
    arm = query.model.arrays.robot.arm
    within = (q >= np.asarray(arm.lower) - 1e-6).all() and (q <= np.asarray(arm.upper) + 1e-6).all()
    return bool(within) and reaches(query.checker, q, _matrix(query.target)) and query.checker.free(q[None])


def _matrix(pose: Float[np.ndarray, " 7"]) -> Float[np.ndarray, "4 4"]:
    out = np.eye(4)
    out[:3, :3] = Rotation.from_quat(pose[:4], scalar_first=True).as_matrix()
    out[:3, 3] = pose[4:]
    return out


def _pose(matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, " 7"]:
    return np.append(Rotation.from_matrix(matrix[:3, :3]).as_quat(scalar_first=True), matrix[:3, 3])


# --- what is shown ----------------------------------------------------------------------------------------------------


def _figures(answers: Sequence[Record]) -> Record:
    if not answers:
        return {"solved": 0}
    seconds = [answer["seconds"] for answer in answers]
    solved = sum(answer["solved"] for answer in answers)
    figures: Record = {
        "solved": solved,
        "share": solved / len(answers),
        "share_95": wilson(solved, len(answers)),
        "wrong": sum(answer["found"] and not answer["solved"] for answer in answers),
        "seconds_median": float(np.median(seconds)),
        "seconds_p90": float(np.quantile(seconds, 0.9)),
    }
    if "seconds_in_batch" in answers[0]:
        figures["seconds_in_batch_median"] = float(np.median([answer["seconds_in_batch"] for answer in answers]))
    if "first_reached" in answers[0]:
        figures["first_start_share"] = float(np.mean([answer["first_reached"] for answer in answers]))
        figures["starts_mean"] = float(np.mean([answer["starts"] for answer in answers]))
    return figures


def _show(report: Record) -> None:
    columns = ("poses", "solver", "solved", "% (95 %)", "ms", "p90", "batch")
    table = Table(*columns, title=f"inverse kinematics, scenes {report['seeds']}")
    for kind, figures in report["kinds"].items():
        for i, (key, name) in enumerate((("ours", "IkSolve"), ("mink", "mink"))):
            row = figures[key]
            if not figures["poses"]:
                continue
            low, high = row["share_95"]
            times = [row["seconds_median"], row["seconds_p90"], row.get("seconds_in_batch_median")]
            table.add_row(
                f"{figures['poses']} {kind}" if i == 0 else "",
                name,
                str(row["solved"]),
                f"{100 * row['share']:.1f} ({100 * low:.1f}–{100 * high:.1f})",
                *("–" if seconds is None else f"{1e3 * seconds:.1f}" for seconds in times),
            )
    console = Console()
    console.print(table)
    console.print("times per pose: median and 90 %; batch: all poses of a scene at once", highlight=False)
    everything = report["kinds"]["all"]
    if everything["left_out"]:
        message = f"{everything['left_out']} grasps left out: no configuration known that keeps all margins"
        console.print(message, highlight=False)
    for seed, number, message in everything["missed"]:
        console.print(f"IkSolve missed seed {seed}, pose {number}: {message}", markup=False, highlight=False)
    for error, seeds in report["crashed"].items():
        console.print(f"crashed: {error}, seeds {seeds}", style="red", markup=False, highlight=False)


def _paint(scenes: Sequence[Record], axes: Axes) -> None:
    queries = [query for scene in scenes for query in scene.get("queries", ()) if query["solvable"]]

    def seconds(name: str, part: str = "seconds") -> Float[np.ndarray, " N"]:
        return np.array([query[name][part] if query[name]["solved"] else np.inf for query in queries])

    series = {
        "IkSolve": seconds("ours"),
        "IkSolve, all poses of a scene at once": seconds("ours", "seconds_in_batch"),
        "mink, start after start": seconds("mink"),
    }
    shares(axes, series, "seconds per pose", (OURS, OURS_TOO, PEER))
    axes.set_title("poses solved, free of collisions")
