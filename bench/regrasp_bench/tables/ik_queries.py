"""Gripper poses for solvers of inverse kinematics: random ones, and those of grasps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import RigidTransform

from regrasp_bench.peers.coal_checker import ExactChecker
from regrasp_planner.pose import rigid, wxyz_xyz

if TYPE_CHECKING:
    from regrasp_planner import Robot, Task
    from regrasp_planner.collision.model import CollisionModel

KINDS = ("random", "random, close", "grasp at pick", "grasp at place")
CLOSE = 0.02
"""Clearance (metres) below which a random configuration counts as close to an obstacle."""


@dataclass(frozen=True)
class IkQuery:
    """A gripper pose to reach.

    Attributes:
        kind: one of `KINDS`.
        model: bodies and pairs.
        checker: the same for coal.
        target: (7,) pose of the gripper in the world, wxyz_xyz.
        theta: finger coordinate.
    """

    kind: str
    model: CollisionModel
    checker: ExactChecker
    target: Float[np.ndarray, " 7"]
    theta: float

    @property
    def matrix(self) -> Float[np.ndarray, "4 4"]:
        """The target as a matrix."""
        return rigid(self.target).as_matrix()


def random_queries(task: Task, robot: Robot, count: int, rng: np.random.Generator) -> list[IkQuery]:
    """Gripper poses of random configurations that keep all margins: ``count`` anywhere, ``count`` close ones."""
    from regrasp_planner.stages.collision_models import CollisionModels
    from regrasp_planner.stages.options import MotionOptions

    models = CollisionModels(robot, task.target, task.pick.obstacles, MotionOptions())
    model, theta = models.empty_handed(task.pick.target_pose), float(robot.gripper.upper)
    checker = ExactChecker(model, theta)
    left = {"random": count, "random, close": count}
    queries: list[IkQuery] = []
    while any(left.values()):
        q = rng.uniform(checker.lower, checker.upper, (1, robot.arm.dof))
        if not checker.keeps_margins(q)[0]:
            continue
        close = bool(checker.clearances(q, cap=CLOSE).min() < CLOSE)
        kind = "random, close" if close and left["random, close"] else "random"
        if left[kind]:
            left[kind] -= 1
            gripper = RigidTransform.from_matrix(checker.frames(q)[0, -2])
            queries.append(IkQuery(kind, model, checker, wxyz_xyz(gripper), theta))
    return queries


def grasp_queries(task: Task, robot: Robot, count: int) -> list[IkQuery]:
    """Gripper poses of ``count`` grasps in the pick scene, and of as many in the place scene."""
    from regrasp_planner import generate_grasps
    from regrasp_planner.stages.collision_models import CollisionModels
    from regrasp_planner.stages.options import MotionOptions

    models = CollisionModels(robot, task.target, task.pick.obstacles, MotionOptions())
    queries: list[IkQuery] = []
    for kind, scene in (("grasp at pick", task.pick), ("grasp at place", task.place)):
        model = models.empty_handed(scene.target_pose)
        for grasp in generate_grasps(task.target, (scene,), robot.gripper).grasps[:count]:
            target, theta = np.asarray(grasp.gripper_pose(scene.target_pose)), float(grasp.opening)
            queries.append(IkQuery(kind, model, ExactChecker(model, theta), target, theta))
    return queries
