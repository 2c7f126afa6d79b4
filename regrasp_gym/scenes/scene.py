"""What every scene is made of: things that move, things that stay, and where the target may be put down in between."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from regrasp_gym.objects.model import ObjectModel

Pose = Float[np.ndarray, " 7"]
"""wxyz_xyz: unit quaternion, then position in metres."""


@dataclass(frozen=True, eq=False)
class PlacedObject:
    """An object that can be pushed about, and the pose it starts at.

    Attributes:
        model: shape, mass and looks.
        pose: (7,) of the object frame in the world.
    """

    model: ObjectModel
    pose: Pose

    @property
    def name(self) -> str:
        """Name of the object's body in the physics and in the planner's task."""
        return self.model.name


@dataclass(frozen=True, eq=False)
class Fixture:
    """A box that never moves: a table top, a board, a wall, a slope.

    Attributes:
        name: for messages, and the name of its body.
        size: (3,) full edge lengths, metres.
        pose: (7,) of its middle in the world.
        material: what it looks like, a key of `regrasp_gym.rendering.materials.MATERIALS`.
        support: whether objects may rest on it.
    """

    name: str
    size: Float[np.ndarray, " 3"]
    pose: Pose
    material: str
    support: bool = False


@dataclass(frozen=True, eq=False)
class ReleasePatch:
    """Flat, horizontal rectangle that is kept free, where the target may be put down.

    Attributes:
        center: (3,) middle of the surface, metres, world.
        half_extents: (2,) half sizes along world x and y, metres.
    """

    center: Float[np.ndarray, " 3"]
    half_extents: Float[np.ndarray, " 2"]


@runtime_checkable
class Scene(Protocol):
    """What an environment needs to know of a scene, whatever the scenario."""

    @property
    def seed(self) -> int:
        """The seed the scene was made from."""
        ...

    @property
    def target(self) -> PlacedObject:
        """The object to be moved."""
        ...

    @property
    def goal_pose(self) -> Pose:
        """(7,) where the target is to come to rest."""
        ...

    @property
    def others(self) -> tuple[PlacedObject, ...]:
        """All objects but the target."""
        ...

    @property
    def fixtures(self) -> tuple[Fixture, ...]:
        """Everything that never moves, but the robot."""
        ...

    @property
    def release(self) -> ReleasePatch:
        """Where the target may be put down in between."""
        ...

    @property
    def instruction(self) -> str:
        """The task in words."""
        ...
