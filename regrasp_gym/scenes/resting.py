"""How an object can lie on a flat surface, from the exact facets of its hull, and how likely each way is.

Deliberately apart from the planner's `stable_poses`: a seed must give the same scene however the planner's optimiser
evolves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from regrasp_gym.objects.model import ObjectModel

MIN_MARGIN = 0.002
"""Least distance (metres) of the centre of mass from the edge of the facet it rests on."""

_COPLANAR = 1e-6


@dataclass(frozen=True, eq=False)
class RestingPose:
    """One way an object rests on a horizontal plane, up to its turn about the vertical.

    Attributes:
        rotation: (3, 3) of the object frame in the world, at yaw zero.
        height: of the object frame's origin above the plane, metres.
        down: (3,) unit direction in the object frame that points down.
        probability: share of random drops that end here (quasi-static rolling), in [0, 1].
        margin: distance of the centre of mass from the edge of the supporting facet, metres.
        footprint: (K, 2) convex polygon that the hull covers from above, counter-clockwise, metres, at yaw zero.
    """

    rotation: Float[np.ndarray, "3 3"]
    height: float
    down: Float[np.ndarray, " 3"]
    probability: float
    margin: float
    footprint: Float[np.ndarray, "K 2"]

    @property
    def level_width(self) -> float:
        """Least distance (metres) of two upright, parallel planes that hold the object as it lies."""
        return float(np.ptp(self.footprint @ self.level_axis))

    @property
    def level_axis(self) -> Float[np.ndarray, " 2"]:
        """(2,) horizontal unit normal of these two planes at yaw zero."""
        edges = np.roll(self.footprint, -1, axis=0) - self.footprint
        normals = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.linalg.norm(edges, axis=1, keepdims=True)
        return normals[np.ptp(self.footprint @ normals.T, axis=0).argmin()]


@lru_cache(maxsize=256)
def resting_poses(model: ObjectModel) -> tuple[RestingPose, ...]:
    """All ways in which the object rests on a plane, most likely first; their probabilities sum to one.

    The object starts on a facet as often as its solid angle, seen from the centre of mass, tells, and rolls over the
    edge that the centre of mass is farthest beyond until it is above the facet (Goldberg, Mirtich, Zhuang, Craig,
    Carlisle, Canny, "Part pose statistics: estimators and experiments", IEEE T-RA 1999). Facets with less than
    `MIN_MARGIN` are left out.
    """
    points = np.concatenate(model.pieces)
    points = points[ConvexHull(points).vertices]
    facets = _facets(points)
    resting = [_roll_to_rest(facets, k) for k in range(len(facets))]
    share = np.zeros(len(facets))
    np.add.at(share, resting, [facet.solid_angle / (4 * np.pi) for facet in facets])
    keep = [k for k in np.unique(resting) if facets[k].margin >= MIN_MARGIN]
    keep = keep or [max(np.unique(resting), key=lambda k: facets[k].margin)]
    keep.sort(key=lambda k: -share[k])
    total = share[keep].sum()
    return tuple(_resting_pose(points, facets[k], share[k] / total) for k in keep)


@lru_cache(maxsize=256)
def upright_pose(model: ObjectModel, tolerance: float = np.deg2rad(10)) -> RestingPose | None:
    """The resting pose nearest to upright, or None if there is none within ``tolerance`` radians."""
    best = max(resting_poses(model), key=lambda pose: -pose.down[2])
    return best if -best.down[2] >= np.cos(tolerance) else None


def least_width(model: ObjectModel) -> float:
    """Least distance (metres) of two parallel planes that hold the object, one of them on a facet of its hull.

    An upper bound of the width of the hull, equal to it unless the least width is between two edges.
    """
    points = np.concatenate(model.pieces)
    normals = ConvexHull(points).equations[:, :3]
    return float(np.ptp(points @ normals.T, axis=0).min())


@dataclass(frozen=True, eq=False)
class _Facet:
    """A facet: outward normal, offset from the centre of mass, corners in order, edge normals and clearances."""

    normal: np.ndarray
    corners: np.ndarray
    indices: tuple[int, ...]
    edge_clearance: np.ndarray
    solid_angle: float

    @property
    def margin(self) -> float:
        return float(self.edge_clearance.min())


def _facets(points: np.ndarray) -> list[_Facet]:
    equations = ConvexHull(points).equations
    facets: list[_Facet] = []
    seen: set[frozenset[int]] = set()
    for equation in equations:
        on = np.flatnonzero(np.abs(points @ equation[:3] + equation[3]) < _COPLANAR)
        if frozenset(on.tolist()) not in seen:
            seen.add(frozenset(on.tolist()))
            facets.append(_facet(points, equation[:3], on))
    return facets


def _facet(points: np.ndarray, normal: np.ndarray, on: np.ndarray) -> _Facet:
    middle = points[on].mean(axis=0)
    across = points[on[0]] - middle
    across /= np.linalg.norm(across)
    spokes = points[on] - middle
    order = np.argsort(np.arctan2(spokes @ np.cross(normal, across), spokes @ across))
    corners = points[on[order]]
    edges = np.roll(corners, -1, axis=0) - corners
    inward = np.cross(normal, edges)
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    # The centre of mass is the origin, and moving it along the normal does not change these.
    clearance = -np.einsum("ij,ij->i", inward, corners)
    return _Facet(normal, corners, tuple(on[order].tolist()), clearance, _solid_angle(corners))


def _solid_angle(corners: np.ndarray) -> float:
    """Solid angle of a polygon seen from the origin (Van Oosterom and Strackee, IEEE T-BME 1983)."""
    total = 0.0
    for i in range(1, len(corners) - 1):
        a, b, c = corners[0], corners[i], corners[i + 1]
        la, lb, lc = np.linalg.norm(a), np.linalg.norm(b), np.linalg.norm(c)
        below = la * lb * lc + (a @ b) * lc + (a @ c) * lb + (b @ c) * la
        total += 2 * np.arctan2(abs(a @ np.cross(b, c)), below)
    return total


def _roll_to_rest(facets: Sequence[_Facet], start: int) -> int:
    """Facet that the object rests on at last. The centre of mass sinks at every roll, so this ends."""
    now = start
    while facets[now].margin < 0:
        edge = int(facets[now].edge_clearance.argmin())
        indices = facets[now].indices
        ends = {indices[edge], indices[(edge + 1) % len(indices)]}
        now = next(k for k, facet in enumerate(facets) if k != now and ends <= set(facet.indices))
    return now


def _resting_pose(points: np.ndarray, facet: _Facet, probability: float) -> RestingPose:
    rotation = _turning_down(facet.normal)
    placed = points @ rotation.T
    flat = placed[:, :2]
    return RestingPose(
        rotation=rotation,
        height=float(-placed[:, 2].min()),
        down=facet.normal,
        probability=float(probability),
        margin=facet.margin,
        footprint=flat[ConvexHull(flat).vertices],
    )


def _turning_down(direction: np.ndarray) -> np.ndarray:
    """The rotation by the least angle that turns a unit direction to −z, (3, 3)."""
    down = np.array([0.0, 0.0, -1.0])
    cosine = float(direction @ down)
    if cosine < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    axis = np.cross(direction, down)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1 + cosine)
