"""Queries for path planners: what the planner asks while it plans a scene, and random ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from regrasp_bench.peers.coal_checker import ExactChecker

if TYPE_CHECKING:
    from regrasp_gym.envs.base import RegraspEnv
    from regrasp_planner import Robot, Task, Trajectory
    from regrasp_planner.path.path_plan import PathResult
    from regrasp_planner.path.query import LineQuery, PathQuery
    from regrasp_planner.path.space import ConfigurationSpace

type KindedQuery = tuple[str, PathQuery]
"""A query and its kind, one of `KINDS`."""

KINDS = ("planned", "planned, holding", "random", "random, holding")
_ATTEMPTS = 1000


@dataclass(frozen=True)
class CartesianPath:
    """A straight motion of the gripper from a grasp, as PathPlan found it.

    Attributes:
        space: bodies, pairs and finger coordinate.
        trajectory: the motion.
    """

    space: ConfigurationSpace
    trajectory: Trajectory


def planner_queries(env: RegraspEnv, strategy: str) -> tuple[list[KindedQuery], list[CartesianPath]]:
    """All path queries of one plan of a scene, answered or not, and all straight lines that the planner found."""
    from regrasp_planner import plan

    recorder = _Recorder()
    plan(env.task(), env.planner_robot, strategy, options=env.plan_options(), observer=recorder)
    return recorder.queries, recorder.lines


class _Recorder:
    """A `regrasp_planner.stages.motion.PathObserver` that keeps all path queries and all lines found."""

    def __init__(self) -> None:
        self.queries: list[KindedQuery] = []
        self.lines: list[CartesianPath] = []

    def on_path(self, query: PathQuery, result: PathResult) -> None:
        """Keep the query."""
        del result
        kind = "planned, holding" if "held" in query.space.model.body_names else "planned"
        self.queries.append((kind, query))

    def on_line(self, query: LineQuery, result: PathResult) -> None:
        """Keep the line, if there is one."""
        if result.trajectory is not None:
            self.lines.append(CartesianPath(query.space, result.trajectory))


def random_queries(task: Task, robot: Robot, count: int, rng: np.random.Generator) -> list[KindedQuery]:
    """Random pairs of free configurations with an obstacle between, with an empty gripper and with the target in it.

    There are ``count`` of each kind, or fewer if `_ATTEMPTS` do not find them.
    """
    from regrasp_planner.grasp.grasp_gen import generate_grasps
    from regrasp_planner.path.query import PathQuery
    from regrasp_planner.path.space import ConfigurationSpace
    from regrasp_planner.stages.collision_models import CollisionModels
    from regrasp_planner.stages.options import MotionOptions

    models = CollisionModels(robot, task.target, task.pick.obstacles, MotionOptions())
    worlds = [("random", models.empty_handed(task.pick.target_pose), float(robot.gripper.upper))]
    grasps = generate_grasps(task.target, (task.pick,), robot.gripper).grasps
    if grasps:
        worlds.append(("random, holding", models.holding(grasps[0]), float(grasps[0].theta)))
    queries: list[KindedQuery] = []
    for kind, model, theta in worlds:
        space = ConfigurationSpace(model, theta)
        checker = ExactChecker(model, theta)
        found: list[KindedQuery] = []
        for _ in range(_ATTEMPTS):
            if len(found) == count:
                break
            start, goal = rng.uniform(space.lower, space.upper, (2, robot.arm.dof))
            if checker.free(np.stack([start, goal])) and not checker.free(np.linspace(start, goal, 200)):
                found.append((kind, PathQuery(space, start, goal)))
        queries += found
    return queries
