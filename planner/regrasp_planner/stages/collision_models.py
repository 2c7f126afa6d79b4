"""Collision models of one task: the arm alone, with an empty hand, and with the target in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from regrasp_planner.collision.model import CollisionModel, collision_model
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.grasp.grasp import Grasp
from regrasp_planner.pose import IDENTITY, Pose, rigid, wxyz_xyz
from regrasp_planner.robot.model import Robot
from regrasp_planner.stages.options import MotionOptions
from regrasp_planner.task import Body, Obstacle


class CollisionModels:
    """Collision models of the robot among the task's obstacles, each made once.

    Args:
        robot: arm, gripper and their bodies.
        target: the body to move.
        obstacles: everything else in the scene.
        options: the margins.
    """

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
        return self._model(self.obstacles, {("gripper", "world"): None})

    @cached_property
    def _empty(self) -> CollisionModel:
        obstacles = (*self.obstacles, Obstacle(self.target, IDENTITY))
        return self._model(obstacles, {("gripper", self.target.name): self.options.margin_target})

    @cached_property
    def _full(self) -> CollisionModel:
        return self._model(self.obstacles, held=self.target.pieces)

    def _model(
        self,
        obstacles: Sequence[Obstacle],
        overrides: Mapping[tuple[str, str], float | None] | None = None,
        held: Sequence[ConvexBody] = (),
    ) -> CollisionModel:
        world, margin = self.options.margin_world, self.options.margin_held
        return collision_model(
            self.robot, obstacles, held=held, margin_world=world, margin_held=margin, overrides=overrides
        )
