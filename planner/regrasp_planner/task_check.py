"""Whether a task can be planned with at all."""

from __future__ import annotations

import numpy as np

from regrasp_planner.errors import TaskError
from regrasp_planner.pose import Pose
from regrasp_planner.robot import Robot, check_configuration
from regrasp_planner.scene import Task


def check_task(task: Task, robot: Robot) -> None:
    """Raise `TaskError` naming the first thing about the task that can not be planned with."""
    named: list[tuple[str, Pose]] = [("pick", task.pick.target_pose), ("place", task.place.target_pose)]
    named += [(obstacle.body.name, obstacle.pose) for obstacle in (*task.pick.obstacles, *task.place.obstacles)]
    for name, pose in named:
        pose = np.asarray(pose, float)
        if pose.shape != (7,) or not np.isfinite(pose).all() or abs(np.linalg.norm(pose[:4]) - 1) > 1e-3:
            raise TaskError(f"pose of {name!r} is {pose}; give (7,) wxyz_xyz with a unit quaternion, in metres")
    scenes = ({id(obstacle) for obstacle in scene.obstacles} for scene in (task.pick, task.place))
    if len(set(map(frozenset, scenes))) > 1:
        raise TaskError("the pick and the place scene differ in their obstacles; give both scenes all of them")
    _check_names(task)
    target = task.target
    if not target.pieces:
        raise TaskError(f"target {target.name!r} has no convex pieces; give it at least one")
    swept = max(float(piece.radius) for piece in target.pieces)
    if swept > 1e-3:
        raise TaskError(
            f"target {target.name!r} is swept by {swept} m (a capsule or sphere); give the vertices of a polyhedron"
        )
    center = np.asarray(target.center_of_mass, float)
    if center.shape != (3,) or not np.isfinite(center).all():
        raise TaskError(f"centre of mass of {target.name!r} is {center}; give (3,) metres")
    area = np.concatenate([task.release.center, task.release.half_extents])
    if area.shape != (5,) or not np.isfinite(area).all() or (np.asarray(task.release.half_extents) <= 0).any():
        raise TaskError(
            f"release area {area} is no rectangle; give a centre (3,) and half extents (2,) above 0, metres"
        )
    try:
        check_configuration(robot, task.start)
    except ValueError as error:
        raise TaskError(f"start: {error}") from error


def _check_names(task: Task) -> None:
    names = [task.target.name, *(obstacle.body.name for obstacle in task.pick.obstacles)]
    reserved = {"", "held", "world", "arm", "gripper", "fingers", "palm", "finger0", "finger1"}
    for name in names:
        if name in reserved or names.count(name) > 1:
            raise TaskError(f"{name!r} names more than one thing; give the target and each obstacle a name of its own")
    unknown = task.supports - set(names)
    if unknown:
        raise TaskError(f"support {sorted(unknown)[0]!r} is not among the obstacles {sorted(names[1:])}")
