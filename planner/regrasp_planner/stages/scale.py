"""Robots of any size: the planner works with lengths in units of the gripper.

Margins, step sizes, tolerances and heights of the planner's modules suit a gripper that opens `OPENING`. Any other
robot is planned for at that scale: `to_planner_scale` multiplies all lengths of robot and task by one factor (angles,
joint positions and finger coordinates stay as they are), and `to_metres` brings the stages back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.grasp.grasp import Grasp
from regrasp_planner.memo import IdentityMemo
from regrasp_planner.pose import Pose
from regrasp_planner.robot.model import Robot
from regrasp_planner.stages.plan import Stage
from regrasp_planner.task import Body, Obstacle, ReleaseArea, Scene, Task

OPENING = 0.08
"""Gripper opening that the planner's lengths suit, metres."""

_SCALED = IdentityMemo()
"""Robots and bodies at another scale, by factor."""


def planner_scale(robot: Robot) -> float:
    """Factor that brings the lengths of a robot and its tasks to the planner's scale; exactly 1 for `OPENING`."""
    factor = OPENING / float(robot.gripper.max_opening)
    return 1.0 if abs(factor - 1) < 1e-6 else factor


def to_planner_scale(task: Task, robot: Robot) -> tuple[Task, Robot]:
    """The task and the robot at the planner's scale; the same objects if they are already."""
    factor = planner_scale(robot)
    return scaled_task(task, factor), scaled_robot(robot, factor)


def to_metres(stages: Sequence[Stage], factor: float) -> tuple[Stage, ...]:
    """Stages planned at ``factor`` times the real scale, back in metres."""
    return tuple(stages) if factor == 1 else tuple(_stage(stage, 1 / factor) for stage in stages)


def scaled_robot(robot: Robot, factor: float) -> Robot:
    """The robot with all lengths multiplied by ``factor``; made once per robot."""
    if factor == 1:
        return robot

    def scale() -> Robot:
        arm, gripper = robot.arm, robot.gripper
        along = jnp.array([factor, factor, factor, 1.0, 1.0, 1.0])
        return replace(
            robot,
            arm=replace(
                arm,
                origins=jnp.asarray(scaled_pose(np.asarray(arm.origins), factor)),
                base=jnp.asarray(scaled_pose(np.asarray(arm.base), factor)),
                tool=jnp.asarray(scaled_pose(np.asarray(arm.tool), factor)),
            ),
            gripper=replace(
                gripper,
                palm=_body(gripper.palm, factor),
                fingers=_body(gripper.fingers, factor),
                screws=gripper.screws * along,
                max_opening=gripper.max_opening * factor,
            ),
            links=_body(robot.links, factor),
            unit=robot.unit / factor,
        )

    return _SCALED.get(robot, scale, factor)


def scaled_task(task: Task, factor: float) -> Task:
    """The task with all lengths multiplied by ``factor``. Obstacles shared by both scenes stay shared."""
    if factor == 1:
        return task
    obstacles: dict[int, Obstacle] = {}

    def scene(one: Scene) -> Scene:
        for obstacle in one.obstacles:
            if id(obstacle) not in obstacles:
                moved = Obstacle(scaled_body(obstacle.body, factor), scaled_pose(obstacle.pose, factor))
                obstacles[id(obstacle)] = moved
        kept = tuple(obstacles[id(obstacle)] for obstacle in one.obstacles)
        return Scene(one.name, scaled_pose(one.target_pose, factor), kept)

    area = task.release
    return replace(
        task,
        target=scaled_body(task.target, factor),
        pick=scene(task.pick),
        place=scene(task.place),
        release=ReleaseArea(area.center * factor, area.half_extents * factor),
    )


def scaled_body(body: Body, factor: float) -> Body:
    """The body with all lengths multiplied by ``factor``; made once per body."""

    def scale() -> Body:
        pieces = tuple(_body(piece, factor) for piece in body.pieces)
        return Body(body.name, pieces, np.asarray(body.center_of_mass) * factor, body.mass)

    return _SCALED.get(body, scale, factor)


def scaled_grasp(grasp: Grasp, factor: float) -> Grasp:
    """The grasp with all lengths multiplied by ``factor``; finger coordinates stay as they are."""
    if factor == 1:
        return grasp
    return replace(grasp, pose=scaled_pose(grasp.pose, factor), clearance=grasp.clearance * factor)


def scaled_pose(pose: Pose, factor: float) -> Pose:
    """Pose or poses (…, 7) with the position multiplied by ``factor``."""
    pose = np.asarray(pose, float)
    return np.concatenate([pose[..., :4], pose[..., 4:] * factor], axis=-1)


def _stage(stage: Stage, factor: float) -> Stage:
    return replace(
        stage,
        grasp=scaled_grasp(stage.grasp, factor),
        start_pose=scaled_pose(stage.start_pose, factor),
        release_pose=scaled_pose(stage.release_pose, factor),
        settled_pose=scaled_pose(stage.settled_pose, factor),
    )


def _body(body: ConvexBody, factor: float) -> ConvexBody:
    lengths = (np.asarray(leaf) * factor for leaf in (body.vertices, body.center, body.radius))
    vertices, center, radius = lengths
    return replace(body, vertices=vertices, center=center, radius=radius)
