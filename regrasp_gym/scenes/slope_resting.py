"""How a stone lies on an inclined plane: its facets, the ground that they cover, and how far it is from tipping."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from regrasp_gym.errors import SceneError
from regrasp_gym.geometry.facets import Facets, find_facets
from regrasp_gym.geometry.polygons import clearance, half_planes
from regrasp_gym.geometry.poses import Pose, about_z, mujoco_quaternion, to_pose, turn, turning_down
from regrasp_gym.objects.model import ObjectModel
from regrasp_gym.scenes.scene import PlacedObject

SHORTEST_EDGE = 0.03
"""Least edge (metres) of a facet that a stone may lie on.

MuJoCo holds a facet up by at most four of its corners and may choose others at every step. If two of the four are next
to each other the other two can be too few, and the stone trembles at some mm/s.
"""


@dataclass(frozen=True, eq=False)
class Plane:
    """An inclined plane that things lie on.

    Attributes:
        rotation: (3, 3), its columns are the plane's x, y and normal in the world.
        origin: (3,) a point of it, metres, world.
    """

    rotation: Float[np.ndarray, "3 3"]
    origin: Float[np.ndarray, " 3"]

    @property
    def fall(self) -> Float[np.ndarray, " 2"]:
        """(2,) where the vertical through a point at height 1 above the plane meets it, in its coordinates."""
        down = -self.rotation[2]
        return down[:2] / -down[2]

    @property
    def inclination(self) -> float:
        """Angle between the plane and the horizontal, radians."""
        return float(np.arccos(np.clip(self.rotation[2, 2], -1, 1)))

    def to_world(
        self, rotation: Float[np.ndarray, "3 3"], position: Float[np.ndarray, " 3"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (3, 3) and position (3,) in the world of what has these in the plane's frame."""
        return self.rotation @ rotation, self.origin + self.rotation @ position

    def to_plane(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """World points in the plane's frame."""
        return (points - self.origin) @ self.rotation


@dataclass(frozen=True, eq=False)
class Seat:
    """A facet of a stone that it may lie on.

    Attributes:
        model: the stone.
        facets: of the stone.
        facet: which of them.
    """

    model: ObjectModel
    facets: Facets
    facet: int

    @property
    def normal(self) -> Float[np.ndarray, " 3"]:
        """(3,) outward, object frame."""
        return self.facets.normals[self.facet]

    @property
    def solid_angle(self) -> float:
        """Of the facet from the centre of mass, as a share of the sphere."""
        return float(self.facets.solid_angles[self.facet])

    @cached_property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """(3, 3) the least turn that brings the normal to −z of the plane."""
        return turning_down(self.normal)

    @cached_property
    def height(self) -> float:
        """Height of the centre of mass above the plane, metres."""
        return float((self.model.pieces[0] @ self.normal).max())

    @cached_property
    def corners(self) -> Float[np.ndarray, "K 2"]:
        """(K, 2) of the facet after the turn, counter-clockwise from above, about the centre of mass, metres."""
        return (self.facets.corners(self.facet) @ self.rotation.T)[::-1, :2]

    @cached_property
    def footprint(self) -> Float[np.ndarray, "L 2"]:
        """(L, 2) of the whole stone seen along the plane's normal, likewise."""
        outline = self.model.pieces[0] @ self.rotation[:2].T
        return outline[ConvexHull(outline).vertices]

    @property
    def width(self) -> float:
        """Least distance (metres) of two parallel planes along the normal that hold the stone."""
        normals, offsets = half_planes(self.footprint)
        return float((offsets - (self.footprint @ normals.T).min(axis=0)).min())

    def margin(self, yaws: Float[np.ndarray, " T"], fall: Float[np.ndarray, " 2"]) -> Float[np.ndarray, " T"]:
        """Distance (metres) from the facet's edge of where gravity through the centre of mass meets the plane.

        Args:
            yaws: (T,) turns about the plane's normal, radians.
            fall: (2,) of the plane, see `Plane.fall`.
        """
        return clearance(self.corners, self.height * (turn(-np.asarray(yaws)) @ fall))


def seats(model: ObjectModel) -> tuple[Seat, ...]:
    """All facets of a convex stone on which it lies stably on level ground, those with very short edges left out.

    Raises:
        SceneError: the object is not one convex piece whose points are all corners.
    """
    piece, *more = model.pieces
    facets = find_facets(piece)
    if more or len(facets.points) < len(piece):
        raise SceneError(f"{model.name!r} is not one convex piece with corners only, as stones are")
    good = (facets.margins > 0) & (facets.shortest_edges >= SHORTEST_EDGE)
    return tuple(Seat(model, facets, int(k)) for k in np.flatnonzero(good))


@dataclass(frozen=True, eq=False)
class Lying:
    """A stone on a plane.

    Attributes:
        model: the stone.
        seat: the facet it lies on.
        plane: what it lies on.
        yaw: its turn about the plane's normal, radians.
        position: (3,) of its centre of mass in the plane's frame, metres.
    """

    model: ObjectModel
    seat: Seat
    plane: Plane
    yaw: float
    position: Float[np.ndarray, " 3"]

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """(3, 3) of the object frame in the plane's frame."""
        return about_z(self.yaw) @ self.seat.rotation

    @property
    def footprint(self) -> Float[np.ndarray, "K 2"]:
        """(K, 2) what it covers along the plane's normal, in the plane's frame, metres."""
        return self.seat.footprint @ turn(self.yaw).T + self.position[:2]

    @property
    def contact(self) -> Float[np.ndarray, "K 2"]:
        """(K, 2) corners of the facet it lies on, in the plane's frame, metres."""
        return self.seat.corners @ turn(self.yaw).T + self.position[:2]

    @property
    def pose(self) -> Pose:
        """(7,) in the world."""
        rotation, position = self.plane.to_world(self.rotation, self.position)
        return to_pose(mujoco_quaternion(rotation), position)

    @property
    def object(self) -> PlacedObject:
        """The stone at its pose in the world."""
        return PlacedObject(self.model, self.pose)

    def points(self) -> Float[np.ndarray, "N 3"]:
        """(N, 3) corners in the world, metres."""
        rotation, position = self.plane.to_world(self.rotation, self.position)
        return self.model.pieces[0] @ rotation.T + position
