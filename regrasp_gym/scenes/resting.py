"""Resting poses of an object on a plane, from the exact facets of its hull, and their probabilities.

Deliberately independent of the planner's `stable_poses`: a seed must give the same scene whatever the planner's
optimiser becomes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from regrasp_gym.geometry.facets import Facets, counter_clockwise, find_facets
from regrasp_gym.geometry.poses import turning_down
from regrasp_gym.objects.model import ObjectModel

MIN_MARGIN = 0.002
"""Least margin (metres) of a resting pose; see `RestingPose.margin`."""


@dataclass(frozen=True, eq=False)
class RestingPose:
    """A pose of an object at rest on a horizontal plane, up to yaw.

    Attributes:
        rotation: (3, 3) rotation of the object frame in the world at yaw zero.
        height: height of the object frame's origin above the plane, metres.
        down: (3,) unit direction that points down, object frame.
        probability: share of random drops that end here (quasi-static rolling), in [0, 1].
        margin: horizontal distance of the centre of mass from the edge of the supporting facet, metres.
        footprint: (K, 2) hull seen from above at yaw zero, counter-clockwise, metres.
    """

    rotation: Float[np.ndarray, "3 3"]
    height: float
    down: Float[np.ndarray, " 3"]
    probability: float
    margin: float
    footprint: Float[np.ndarray, "K 2"]

    @property
    def level_width(self) -> float:
        """Least distance (metres) of two vertical, parallel planes around the lying object."""
        return float(np.ptp(self.footprint @ self.level_axis))

    @property
    def level_axis(self) -> Float[np.ndarray, " 2"]:
        """(2,) horizontal unit normal of these two planes at yaw zero."""
        edges = np.roll(self.footprint, -1, axis=0) - self.footprint
        normals = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.linalg.norm(edges, axis=1, keepdims=True)
        return normals[np.ptp(self.footprint @ normals.T, axis=0).argmin()]


@lru_cache(maxsize=256)
def resting_poses(model: ObjectModel) -> tuple[RestingPose, ...]:
    """All resting poses of the object, most likely first; their probabilities sum to one.

    The object starts on a facet with a probability in proportion to its solid angle from the centre of mass. It rolls
    over the edge that the centre of mass is farthest beyond, until the centre of mass is above the facet (Goldberg,
    Mirtich, Zhuang, Craig, Carlisle, Canny, "Part pose statistics: estimators and experiments", IEEE T-RA 1999). Facets
    with less than `MIN_MARGIN` are left out.
    """
    facets = find_facets(np.concatenate(model.pieces))
    count = len(facets.normals)
    resting = [_roll_to_rest(facets, k) for k in range(count)]
    share = np.zeros(count)
    np.add.at(share, resting, [_solid_angle(facets, k) / (4 * np.pi) for k in range(count)])
    keep = [k for k in np.unique(resting) if facets.margins[k] >= MIN_MARGIN]
    keep = keep or [max(np.unique(resting), key=lambda k: facets.margins[k])]
    keep.sort(key=lambda k: -share[k])
    total = share[keep].sum()
    return tuple(_resting_pose(facets, k, share[k] / total) for k in keep)


@lru_cache(maxsize=256)
def upright_pose(model: ObjectModel, tolerance: float = np.deg2rad(10)) -> RestingPose | None:
    """The resting pose nearest to upright, or None if none is within ``tolerance`` radians."""
    best = max(resting_poses(model), key=lambda pose: -pose.down[2])
    return best if -best.down[2] >= np.cos(tolerance) else None


def least_width(model: ObjectModel) -> float:
    """Least distance (metres) of two parallel planes around the object, one of them on a facet of its hull.

    An upper bound of the hull's width, exact unless the least width is between two edges.
    """
    points = np.concatenate(model.pieces)
    normals = ConvexHull(points).equations[:, :3]
    return float(np.ptp(points @ normals.T, axis=0).min())


def _roll_to_rest(facets: Facets, start: int) -> int:
    """The facet that the object comes to rest on. Its centre of mass sinks with every roll, so this ends."""
    now = start
    while facets.margins[now] < 0:
        edges = np.flatnonzero(facets.facet == now)
        now = facets.across(int(edges[facets.edge_margins[edges].argmin()]))
    return now


def _solid_angle(facets: Facets, facet: int) -> float:
    """Solid angle of a facet seen from the origin.

    Differs from `Facets.solid_angles` in the last bits. Facets of round objects are alike, so these bits set the order
    of resting poses, and the order decides which one a seed draws.
    """
    on = np.unique(facets.edges[facets.facet == facet])
    corners = counter_clockwise(facets.points[on], facets.normals[facet])
    total = 0.0
    for i in range(1, len(corners) - 1):
        a, b, c = corners[0], corners[i], corners[i + 1]
        la, lb, lc = np.linalg.norm(a), np.linalg.norm(b), np.linalg.norm(c)
        below = la * lb * lc + (a @ b) * lc + (a @ c) * lb + (b @ c) * la
        total += 2 * np.arctan2(abs(a @ np.cross(b, c)), below)
    return total


def _resting_pose(facets: Facets, facet: int, probability: float) -> RestingPose:
    rotation = turning_down(facets.normals[facet])
    placed = facets.points @ rotation.T
    flat = placed[:, :2]
    return RestingPose(
        rotation=rotation,
        height=float(-placed[:, 2].min()),
        down=facets.normals[facet],
        probability=float(probability),
        margin=float(facets.margins[facet]),
        footprint=flat[ConvexHull(flat).vertices],
    )
