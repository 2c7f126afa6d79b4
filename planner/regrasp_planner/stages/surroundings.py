"""What the stages of one task share: collision models, margins, and configurations at a grasp."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from regrasp_planner.collision.model import CollisionModel, collision_model
from regrasp_planner.grasp.grasp import Grasp
from regrasp_planner.ik.ik_solve import solve_ik
from regrasp_planner.path.options import PathOptions
from regrasp_planner.pose import IDENTITY, Pose, rigid, wxyz_xyz
from regrasp_planner.robot.model import Robot
from regrasp_planner.task import Body, Obstacle

T = TypeVar("T")


@dataclass(frozen=True)
class MotionOptions:
    """Lengths and margins of a stage's motion, metres.

    Attributes:
        approach: lengths of the straight line over the target and back, tried in turn.
        lift: heights of the straight line off the support after taking the target, tried in turn.
        lower: heights from which the target is lowered onto the support, tried in turn.
        margin_world: clearance of the robot from obstacles on the way.
        margin_target: clearance of the open gripper from the target.
        margin_held: clearance of the held target from obstacles on the way.
        drop: height above the support at which the target is let go, so that the arm does not press it down.
        solutions: configurations tried at each end of a stage.
        joins: pairs of ways to either end between which paths are planned.
        path: options of the path planner.
    """

    approach: tuple[float, ...] = (0.10, 0.06, 0.035)
    lift: tuple[float, ...] = (0.08, 0.03)
    lower: tuple[float, ...] = (0.04, 0.015)
    margin_world: float = 0.003
    margin_target: float = 0.0005
    margin_held: float = 0.005
    drop: float = 0.002
    solutions: int = 3
    joins: int = 3
    path: PathOptions = field(default_factory=lambda: PathOptions(contact_tolerance=3e-3, search_rounds=60))


@dataclass
class Clock:
    """Wall-clock seconds by module."""

    seconds: dict[str, float] = field(default_factory=dict)

    def time(self, module: str, call: Callable[[], T]) -> T:
        """Result of ``call()``, its duration added to the module's."""
        began = time.perf_counter()
        try:
            return call()
        finally:
            self.seconds[module] = self.seconds.get(module, 0.0) + time.perf_counter() - began


def flipped(grasp: Grasp, robot: Robot) -> Grasp:
    """The same grasp with the gripper turned half round about its approach axis: the fingers change places."""
    axis = np.asarray(robot.gripper.approach_axis)
    turn = np.concatenate([[0.0], axis, np.zeros(3)])
    pose = wxyz_xyz(rigid(grasp.pose) * rigid(turn))
    return Grasp(pose, grasp.theta, grasp.opening, grasp.quality, grasp.clearance)


class Surroundings:
    """The task's obstacles and the target at a given pose, as collision models for an empty or a full hand."""

    def __init__(self, robot: Robot, target: Body, obstacles: Sequence[Obstacle], options: MotionOptions):
        self.robot, self.target, self.options = robot, target, options
        self.obstacles = tuple(obstacles)
        self._models: dict[tuple[str, bytes], CollisionModel] = {}

    def empty_handed(self, target_pose: Pose) -> CollisionModel:
        """The target is one more obstacle, which the gripper may come close to."""
        name = self.target.name
        key = (name, np.asarray(target_pose, float).tobytes())
        if key not in self._models:
            self._models[key] = self._empty.moved(name, target_pose)
        return self._models[key]

    def holding(self, grasp: Grasp) -> CollisionModel:
        """The target moves with the gripper."""
        key = ("held", grasp.pose.tobytes())
        if key not in self._models:
            self._models[key] = self._full.moved("held", wxyz_xyz(rigid(grasp.pose).inv()))
        return self._models[key]

    @cached_property
    def arm_alone(self) -> CollisionModel:
        """The arm without its gripper among the obstacles."""
        return collision_model(
            self.robot,
            self.obstacles,
            margin_world=self.options.margin_world,
            overrides={("gripper", "world"): None},
        )

    @cached_property
    def _empty(self) -> CollisionModel:
        return collision_model(
            self.robot,
            (*self.obstacles, Obstacle(self.target, IDENTITY)),
            margin_world=self.options.margin_world,
            overrides={("gripper", self.target.name): self.options.margin_target},
        )

    @cached_property
    def _full(self) -> CollisionModel:
        return collision_model(
            self.robot,
            self.obstacles,
            held=self.target.pieces,
            margin_world=self.options.margin_world,
            margin_held=self.options.margin_held,
        )


@dataclass(frozen=True)
class Ends:
    """Configurations that put the gripper on the target at one end of a stage, best first; or why there are none."""

    configurations: tuple[Float[np.ndarray, " n"], ...]
    constraint: str


def solve_ends(
    surroundings: Surroundings,
    grasps: Sequence[Grasp],
    target_pose: Pose,
    reference: Float[np.ndarray, " n"],
    seed: int,
) -> list[Ends]:
    """IkSolve for several grasps of the target standing at one pose, in one batch.

    Args:
        surroundings: the obstacles.
        grasps: K grasps.
        target_pose: (7,) where the target stands, in the world.
        reference: (n,) configuration to stay near, radians.
        seed: of the random starts.
    """
    model = surroundings.empty_handed(target_pose)
    targets = np.array([grasp.gripper_pose(target_pose) for grasp in grasps])
    openings = np.array([grasp.opening for grasp in grasps])
    results = solve_ik(
        model, targets, openings, reference=reference, max_solutions=surroundings.options.solutions, seed=seed
    )
    return [Ends(tuple(solution.q for solution in result.solutions), result.message) for result in results]
