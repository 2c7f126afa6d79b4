"""What the planner is given: rigid bodies, scenes, and the task of moving one target between two scenes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from regrasp_planner.errors import TaskError
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.pose import Pose
from regrasp_planner.robot.model import Robot, check_configuration


@dataclass(frozen=True)
class Body:
    """A rigid body made of convex pieces.

    Attributes:
        name: for messages.
        pieces: convex pieces, all in the body's frame; one for a convex body.
        center_of_mass: (3,) in the body's frame, metres.
        mass: kilograms; 0 for something that never moves.
    """

    name: str
    pieces: tuple[ConvexBody, ...]
    center_of_mass: Float[np.ndarray, " 3"]
    mass: float = 0.0

    def hull_vertices(self) -> Float[np.ndarray, "N 3"]:
        """Vertices of all pieces, (N, 3) metres; their hull is that of the body, without the sweep of the pieces."""
        return np.concatenate([piece.hull_vertices() for piece in self.pieces])


@dataclass(frozen=True)
class Obstacle:
    """A body at a pose in the world."""

    body: Body
    pose: Pose


@dataclass(frozen=True)
class Scene:
    """The target at a pose among obstacles (the paper's S). All poses are in the world."""

    name: str
    target_pose: Pose
    obstacles: tuple[Obstacle, ...]


@dataclass(frozen=True)
class ReleaseArea:
    """Obstacle-free, flat, horizontal rectangle where the target may be put down.

    Attributes:
        center: (3,) middle of the surface, metres, world.
        half_extents: (2,) half sizes along world x and y, metres.
    """

    center: Float[np.ndarray, " 3"]
    half_extents: Float[np.ndarray, " 2"]


@dataclass(frozen=True)
class Task:
    """Move ``target`` from its pose in ``pick`` to its pose in ``place``.

    Attributes:
        target: the body to move.
        pick: the scene as it is now.
        place: the scene with the target at its goal.
        release: where it may be put down in between.
        start: (n,) configuration of the arm now, radians.
        supports: names of the obstacles that the target may rest on (table, shelf board).
    """

    target: Body
    pick: Scene
    place: Scene
    release: ReleaseArea
    start: Float[np.ndarray, " n"]
    supports: frozenset[str] = frozenset()


_RESERVED_NAMES = {"", "held", "world", "arm", "gripper", "fingers", "palm", "finger0", "finger1"}
"""Names that collision models give to something else."""

_MAX_SWEEP = 1e-3
"""Largest sweep radius of a target's piece, metres."""


def check_task(task: Task, robot: Robot) -> None:
    """Raise `TaskError` naming the first thing about the task that cannot be planned with."""
    _check_poses(task)
    _check_obstacles(task)
    _check_target(task.target)
    _check_release_area(task.release)
    try:
        check_configuration(robot, task.start)
    except ValueError as error:
        raise TaskError(f"start: {error}") from error


def _check_poses(task: Task) -> None:
    named: list[tuple[str, Pose]] = [("pick", task.pick.target_pose), ("place", task.place.target_pose)]
    named += [(obstacle.body.name, obstacle.pose) for obstacle in (*task.pick.obstacles, *task.place.obstacles)]
    for name, pose in named:
        pose = np.asarray(pose, float)
        if pose.shape != (7,) or not np.isfinite(pose).all() or abs(np.linalg.norm(pose[:4]) - 1) > 1e-3:
            raise TaskError(f"pose of {name!r} is {pose}; give (7,) wxyz_xyz with a unit quaternion, in metres")


def _check_obstacles(task: Task) -> None:
    scenes = ({id(obstacle) for obstacle in scene.obstacles} for scene in (task.pick, task.place))
    if len(set(map(frozenset, scenes))) > 1:
        raise TaskError("the pick and the place scene differ in their obstacles; give both scenes all of them")
    names = [task.target.name, *(obstacle.body.name for obstacle in task.pick.obstacles)]
    for name in names:
        if name in _RESERVED_NAMES or names.count(name) > 1:
            raise TaskError(f"{name!r} names more than one thing; give the target and each obstacle a name of its own")
    unknown = task.supports - set(names)
    if unknown:
        raise TaskError(f"support {sorted(unknown)[0]!r} is not among the obstacles {sorted(names[1:])}")


def _check_target(target: Body) -> None:
    if not target.pieces:
        raise TaskError(f"target {target.name!r} has no convex pieces; give it at least one")
    swept = max(float(piece.radius) for piece in target.pieces)
    if swept > _MAX_SWEEP:
        raise TaskError(
            f"target {target.name!r} is swept by {swept} m (a capsule or sphere); give the vertices of a polyhedron"
        )
    center = np.asarray(target.center_of_mass, float)
    if center.shape != (3,) or not np.isfinite(center).all():
        raise TaskError(f"centre of mass of {target.name!r} is {center}; give (3,) metres")


def _check_release_area(release: ReleaseArea) -> None:
    area = np.concatenate([release.center, release.half_extents])
    if area.shape != (5,) or not np.isfinite(area).all() or (np.asarray(release.half_extents) <= 0).any():
        raise TaskError(
            f"release area {area} is no rectangle; give a centre (3,) and half extents (2,) above 0, metres"
        )
