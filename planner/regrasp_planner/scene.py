"""What the planner is given: rigid bodies, scenes, and the task of moving one target between two scenes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.pose import Pose


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
        """Vertices of all pieces together, (N, 3) metres: their hull is that of the body, but for the pieces' sweep."""
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
