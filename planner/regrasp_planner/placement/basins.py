"""Cones of release directions from which an object settles into a stable pose (the paper's §III-C, Fig. 6).

The paper inscribes its cones in alpha shapes of StabPose's starts (`alpha_shape_angles`). `release_cones` needs no
sampling: a convex body released in direction x first falls on the facet that the ray along x from the centre of mass
pierces, and topples on from there (Goldberg, Mirtich, Zhuang, Craig, Carlisle, Canny, IEEE T-RA 1999). So a basin is
bounded by hull edges seen from the centre of mass, which are arcs of great circles, and the cone is exact. A bound on
energy comes on top: an object that falls from too high rolls on, which a basin of steepest descent does not know.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import Delaunay, QhullError

from regrasp_planner.placement.stab_pose import StablePoses

WIDEST = np.deg2rad(80)
"""No cone is wider than this, radians."""

ENERGY = 5.0
"""Greatest fall of an object into a pose, the drop included, in multiples of the pose's barrier.

Impacts leave less than a fifth of that energy, too little to roll on. In 10,000 drops in MuJoCo of 100 objects released
within their basins, 99.6 % came to rest in the predicted pose below 5, 89 % between 5 and 10, and 65 % above."""

STEADY = np.deg2rad(30)
"""A pose that withstands tilts of this angle, radians, has no such limit: none of 230 such drops above 4 rolled on."""

MARGIN = 0.05
"""Angle between a cone and the rim of its basin, radians."""

DROP = 0.002
"""Height of the object above the plane at its release, metres."""


@dataclass(frozen=True)
class ReleaseCone:
    """Release directions from which the target settles into one stable pose.

    Attributes:
        axis: (3,) the stable direction x*, in the target's frame, unit, pointing down.
        half_angle: radians; 0 if the basin is too small, or an object released in the pose itself may not stay in it.
    """

    axis: Float[np.ndarray, " 3"]
    half_angle: float


def release_cones(
    poses: StablePoses, margin: float = MARGIN, drop: float = DROP, energy: float = ENERGY
) -> tuple[ReleaseCone, ...]:
    """Cones K_k inscribed in the basins of attraction, one for each stable pose, in the same order.

    Args:
        poses: stable poses of the target.
        margin: angle between a cone and the rim of its basin, radians.
        drop: height of the target above the plane at its release, metres.
        energy: greatest fall of the centre of mass, the drop included, in multiples of the pose's barrier.
    """
    angles = np.minimum(basin_angles(poses) - margin, energy_angles(poses, drop, energy))
    return tuple(
        ReleaseCone(axis, float(angle))
        for axis, angle in zip(poses.directions, np.clip(angles, 0.0, WIDEST), strict=True)
    )


def basin_angles(poses: StablePoses) -> Float[np.ndarray, " m"]:
    """Angle (m,) between each stable direction and the nearest rim of its basin, radians; π if there is none."""
    ridge, side = np.nonzero(poses.ridge_poses >= 0)
    sides = poses.ridge_poses[ridge, side]
    first, second = poses.ridges[ridge, 0], poses.ridges[ridge, 1]
    axis = poses.directions[sides]
    normal = np.cross(first, second)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # The nearest point of an arc is that of its great circle if it lies between the ends, else the nearer end.
    beside = (axis * normal).sum(axis=1)
    foot = axis - beside[:, None] * normal
    between = ((np.cross(normal, first) * foot).sum(axis=1) > 0) & ((np.cross(second, normal) * foot).sum(axis=1) > 0)
    ends = [_angle(axis, end / np.linalg.norm(end, axis=1, keepdims=True)) for end in (first, second)]
    nearest = np.where(between, np.arcsin(np.clip(np.abs(beside), 0.0, 1.0)), np.minimum(*ends))
    angles = np.full(len(poses), np.pi)
    np.minimum.at(angles, sides, nearest)
    return angles


def energy_angles(poses: StablePoses, drop: float, energy: float) -> Float[np.ndarray, " m"]:
    """Half-angle (m,) of the cone about each stable direction in which h(x) + drop − h(x*) ≤ energy · barrier, radians.

    π for poses that are `STEADY`; negative if the drop alone is too much. Over a cone of half-angle α, a vertex v at
    angle φ from x* is at most |v| cos(max(φ − α, 0)) below the centre of mass, and h is the greatest of these.
    """
    limit = poses.height + energy * poses.barrier - drop
    lengths = np.linalg.norm(poses.corners, axis=1)
    angles = _angle(poses.directions[:, None], poses.corners / lengths[:, None])
    ratio = limit[:, None] / lengths
    allowed = np.where(ratio < 1, angles - np.arccos(np.clip(ratio, -1.0, 1.0)), np.pi)
    return np.where(np.arctan2(poses.margin, poses.height) >= STEADY, np.pi, allowed.min(axis=1))


def alpha_shape_angles(poses: StablePoses, alpha: float | None = None) -> Float[np.ndarray, " m"]:
    """Half-angle (m,) of the cone inscribed in the alpha shape of each basin's starts, as in the paper, radians.

    The starts that settle into a pose, and the pose itself, are mapped to its tangent plane by the logarithm. The alpha
    shape is the part of their Delaunay triangulation with circumradii up to ``alpha``; the cone extends to its nearest
    edge.

    Args:
        poses: stable poses of the target.
        alpha: radians; by default twice the spacing of the starts.
    """
    largest = 2 * float(np.sqrt(4 * np.pi / len(poses.starts))) if alpha is None else alpha
    angles = np.zeros(len(poses))
    for k, (axis, rotation) in enumerate(zip(poses.directions, poses.rotations, strict=True)):
        starts = poses.starts[poses.basin == k]
        flat = starts @ rotation[:2].T
        length = np.linalg.norm(flat, axis=1, keepdims=True)
        points = flat * (_angle(starts, axis)[:, None] / np.maximum(length, 1e-12))
        angles[k] = _inscribed_radius(np.concatenate([np.zeros((1, 2)), points[length[:, 0] > 1e-6]]), largest)
    return angles


def _inscribed_radius(points: Float[np.ndarray, "N 2"], alpha: float) -> float:
    """Distance of the first point from the boundary of the alpha shape; 0 if it lies outside."""
    if len(points) < 4:
        return 0.0
    try:
        triangles = Delaunay(points).simplices
    except QhullError:
        return 0.0
    a, b, c = (points[triangles[:, i]] for i in range(3))
    sides = np.stack([np.linalg.norm(p - q, axis=1) for p, q in ((b, c), (c, a), (a, b))])
    area = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    triangles = triangles[sides.prod(axis=0) <= 4 * alpha * area]
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    rim = edges[count == 1]
    if not (triangles == 0).any() or (rim == 0).any():
        return 0.0
    start, along = points[rim[:, 0]] - points[0], points[rim[:, 1]] - points[rim[:, 0]]
    share = np.clip(-(start * along).sum(axis=1) / (along**2).sum(axis=1), 0, 1)
    return float(np.linalg.norm(start + share[:, None] * along, axis=1).min())


def project(cone: ReleaseCone, x: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """The directions of the cone nearest to the unit directions ``x``, along great circles."""
    axis = cone.axis
    across = x - (x @ axis)[..., None] * axis
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    beyond = np.arctan2(length[..., 0], x @ axis) > cone.half_angle
    # Opposite to the axis, all directions of the rim are equally near.
    other = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side = np.where(length > 1e-12, across / np.maximum(length, 1e-300), other / np.linalg.norm(other))
    rim = np.cos(cone.half_angle) * axis + np.sin(cone.half_angle) * side
    return np.where(beyond[..., None], rim, x)


def _angle(a: Float[np.ndarray, "*batch 3"], b: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
    """Angle between unit vectors, accurate near 0 and π, radians."""
    return 2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
