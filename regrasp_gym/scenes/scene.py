"""Parts of every scene: movable objects, fixtures, and the area where the target may be put down in between."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from regrasp_gym.geometry.poses import Pose
from regrasp_gym.objects.model import ObjectModel


@dataclass(frozen=True, eq=False)
class PlacedObject:
    """A movable object and its start pose.

    Attributes:
        model: shape, mass and looks.
        pose: (7,) pose of the object frame, world.
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
        name: name of its body, also in messages.
        size: (3,) full edge lengths, metres.
        pose: (7,) pose of its centre, world.
        material: key of `regrasp_gym.rendering.materials.MATERIALS`.
        support: whether objects may rest on it.
    """

    name: str
    size: Float[np.ndarray, " 3"]
    pose: Pose
    material: str
    support: bool = False


@dataclass(frozen=True, eq=False)
class ReleasePatch:
    """A horizontal rectangle kept free, where the target may be put down.

    The planner's `ReleaseArea`, without loading JAX.

    Attributes:
        center: (3,) centre of the surface, metres, world.
        half_extents: (2,) half sizes along world x and y, metres.
    """

    center: Float[np.ndarray, " 3"]
    half_extents: Float[np.ndarray, " 2"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene(ABC):
    """A scene as pure data, whatever the scenario.

    Attributes:
        seed, config: seed and configuration it was made from.
        target: the object to move, at its start.
        goal_pose: (7,) goal pose of the target, world.
        fixtures: everything fixed, except the robot.
        release: area where the target may be put down in between.
    """

    seed: int
    config: object
    target: PlacedObject
    goal_pose: Pose
    fixtures: tuple[Fixture, ...]
    release: ReleasePatch

    @property
    @abstractmethod
    def others(self) -> tuple[PlacedObject, ...]:
        """All objects except the target."""

    @property
    @abstractmethod
    def instruction(self) -> str:
        """The task in words."""


def level_support(name: str, size: tuple[float, float, float], center: tuple[float, float], material: str) -> Fixture:
    """A box that objects may rest on, its top face at z = 0.

    Args:
        name: name of the fixture.
        size: full edge lengths along world x, y and z, metres.
        center: x and y of its centre, metres, world.
        material: see `Fixture`.
    """
    pose = np.array([1.0, 0.0, 0.0, 0.0, *center, -size[2] / 2])
    return Fixture(name, np.array(size), pose, material, support=True)
