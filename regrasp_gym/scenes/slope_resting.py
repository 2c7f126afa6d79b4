"""Stones at rest on an inclined plane: supporting facets, footprints and margins against tipping."""

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
"""Shortest edge (metres) of a facet that a stone may lie on.

MuJoCo supports a facet at four of its corners at most, and may choose others at every step. If two of the four are
close together, the other two can be too few, and the stone trembles at some mm/s.
"""


@dataclass(frozen=True, eq=False)
class Plane:
    """An inclined plane.

    Attributes:
        rotation: (3, 3) rotation whose columns are the plane's x, y and normal, world.
        origin: (3,) a point of the plane, metres, world.
    """

    rotation: Float[np.ndarray, "3 3"]
    origin: Float[np.ndarray, " 3"]

    @property
    def fall(self) -> Float[np.ndarray, " 2"]:
        """(2,) point of the plane vertically below a point at height 1 on its normal, in its coordinates."""
        down = -self.rotation[2]
        return down[:2] / -down[2]

    @property
    def inclination(self) -> float:
        """Angle between the plane and the horizontal, radians."""
        return float(np.arccos(np.clip(self.rotation[2, 2], -1, 1)))

    def to_world(
        self, rotation: Float[np.ndarray, "3 3"], position: Float[np.ndarray, " 3"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (3, 3) and position (3,) from the plane's frame to the world."""
        return self.rotation @ rotation, self.origin + self.rotation @ position

    def to_plane(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """World points in the plane's frame."""
        return (points - self.origin) @ self.rotation


@dataclass(frozen=True, eq=False)
class Seat:
    """A facet of a stone that it may lie on.

    Attributes:
        model: the stone.
        facets: facets of the stone.
        facet: index of the facet.
    """

    model: ObjectModel
    facets: Facets
    facet: int

    @property
    def normal(self) -> Float[np.ndarray, " 3"]:
        """(3,) outward unit normal, object frame."""
        return self.facets.normals[self.facet]

    @property
    def solid_angle(self) -> float:
        """Solid angle of the facet from the centre of mass, as a share of the sphere."""
        return float(self.facets.solid_angles[self.facet])

    @cached_property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """(3, 3) the smallest rotation that turns the normal to −z of the plane."""
        return turning_down(self.normal)

    @cached_property
    def height(self) -> float:
        """Height of the centre of mass above the plane, metres."""
        return float((self.model.pieces[0] @ self.normal).max())

    @cached_property
    def corners(self) -> Float[np.ndarray, "K 2"]:
        """(K, 2) rotated corners of the facet about the centre of mass, counter-clockwise from above, metres."""
        return (self.facets.corners(self.facet) @ self.rotation.T)[::-1, :2]

    @cached_property
    def footprint(self) -> Float[np.ndarray, "L 2"]:
        """(L, 2) outline of the stone along the plane's normal, likewise."""
        outline = self.model.pieces[0] @ self.rotation[:2].T
        return outline[ConvexHull(outline).vertices]

    @property
    def width(self) -> float:
        """Least distance (metres) of two parallel planes along the normal around the stone."""
        normals, offsets = half_planes(self.footprint)
        return float((offsets - (self.footprint @ normals.T).min(axis=0)).min())

    def margin(self, yaws: Float[np.ndarray, " T"], fall: Float[np.ndarray, " 2"]) -> Float[np.ndarray, " T"]:
        """Margin (metres) against tipping: distance from the facet's edge to the point below the centre of mass.

        Args:
            yaws: (T,) turns about the plane's normal, radians.
            fall: (2,) see `Plane.fall`.
        """
        return clearance(self.corners, self.height * (turn(-np.asarray(yaws)) @ fall))


def seats(model: ObjectModel) -> tuple[Seat, ...]:
    """Facets on which a convex stone is stable on level ground, except those with very short edges.

    Raises:
        SceneError: the object is not a single convex piece whose points are all corners.
    """
    piece, *more = model.pieces
    facets = find_facets(piece)
    if more or len(facets.points) < len(piece):
        raise SceneError(f"{model.name!r} is not one convex piece with corners only; give a stone")
    good = (facets.margins > 0) & (facets.shortest_edges >= SHORTEST_EDGE)
    return tuple(Seat(model, facets, int(k)) for k in np.flatnonzero(good))


@dataclass(frozen=True, eq=False)
class RestingStone:
    """A stone at rest on a plane.

    Attributes:
        model: the stone.
        seat: the facet it lies on.
        plane: the plane it lies on.
        yaw: turn about the plane's normal, radians.
        position: (3,) centre of mass, plane's frame, metres.
    """

    model: ObjectModel
    seat: Seat
    plane: Plane
    yaw: float
    position: Float[np.ndarray, " 3"]

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """(3, 3) rotation of the object frame in the plane's frame."""
        return about_z(self.yaw) @ self.seat.rotation

    @property
    def footprint(self) -> Float[np.ndarray, "K 2"]:
        """(K, 2) outline along the plane's normal, plane's frame, metres."""
        return self.seat.footprint @ turn(self.yaw).T + self.position[:2]

    @property
    def contact(self) -> Float[np.ndarray, "K 2"]:
        """(K, 2) corners of the facet it lies on, plane's frame, metres."""
        return self.seat.corners @ turn(self.yaw).T + self.position[:2]

    @property
    def pose(self) -> Pose:
        """(7,) pose of the object frame, world."""
        rotation, position = self.plane.to_world(self.rotation, self.position)
        return to_pose(mujoco_quaternion(rotation), position)

    @property
    def object(self) -> PlacedObject:
        """The stone as an object of a scene."""
        return PlacedObject(self.model, self.pose)

    def points(self) -> Float[np.ndarray, "N 3"]:
        """(N, 3) corners of the stone, world, metres."""
        rotation, position = self.plane.to_world(self.rotation, self.position)
        return self.model.pieces[0] @ rotation.T + position
