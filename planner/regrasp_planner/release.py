"""Non-static release (GraspGen⁺): tilt the plane under the target until the gripper clears it, within the basin.

Where the gripper would dip into the ground with the target in its stable pose, the target is let go tilted and settles
into the pose by itself (the paper's Alg. 3). Two pieces make that work: cones of directions that settle into each pose,
and the supporting plane nearest to the nominal one that the gripper clears (Prop. 2, eq. (9)).

The paper fits its cones into alpha shapes of StabPose's starts (`alpha_shape_angles`). `release_cones` does without
sampling: a convex body let go in direction x first falls on the facet that the ray along x from the centre of mass
pierces, and topples on from there (Goldberg, Mirtich, Zhuang, Craig, Carlisle, Canny, IEEE T-RA 1999). So a basin is
bounded by hull edges seen from the centre of mass, which are arcs of great circles, and the cone is exact. To that
comes what a basin of steepest descent does not know: an object that falls from too high does not stop where it should.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import Delaunay, QhullError

from regrasp_planner.stab_pose import StablePoses

WIDEST = np.deg2rad(80)
"""No cone is wider than this, radians."""

ENERGY = 5.0
"""How many times a pose's barrier an object may fall on its way into it, the drop included.

Impacts leave it less than a fifth of that, too little to roll on. In 10,000 drops in MuJoCo, of 100 objects let go
within their basins, 99.6 % rested in the pose predicted below 5, 89 % between 5 and 10, 65 % above."""

STEADY = np.deg2rad(30)
"""A pose that stands up to tilts of this angle has no such limit: none of 230 such drops above 4 went on rolling."""

MARGIN = 0.05
"""Angle kept from the rim of a basin, radians."""

DROP = 0.002
"""Height above the plane from which the object is let go, metres."""


@dataclass(frozen=True)
class ReleaseCone:
    """Directions in which the target may be let go to settle into one stable pose.

    Attributes:
        axis: (3,) the stable direction x*, in the target's frame, unit, pointing down.
        half_angle: radians; 0 where not even an object let go in the pose itself is sure to stay, or the basin is too
            small.
    """

    axis: Float[np.ndarray, " 3"]
    half_angle: float


def release_cones(
    poses: StablePoses, margin: float = MARGIN, drop: float = DROP, energy: float = ENERGY
) -> tuple[ReleaseCone, ...]:
    """Cones K_k inscribed in the basins of attraction, one for each stable pose, in the same order.

    Args:
        poses: of the target.
        margin: angle kept from the rim of the basin, radians.
        drop: height above the plane from which the target is let go, metres.
        energy: how many times the pose's barrier the centre of mass may fall, the drop included.
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
    # The arc's nearest point is where the great circle is nearest, if that lies between the ends.
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

    π for poses that are `STEADY`, negative where the drop alone is too much. Over a cone of half-angle α a vertex v at
    angle φ from x* is at most |v| cos(max(φ − α, 0)) below the centre of mass, and h is the greatest of these.
    """
    limit = poses.height + energy * poses.barrier - drop
    reach = np.linalg.norm(poses.corners, axis=1)
    lean = _angle(poses.directions[:, None], poses.corners / reach[:, None])
    ratio = limit[:, None] / reach
    allowed = np.where(ratio < 1, lean - np.arccos(np.clip(ratio, -1.0, 1.0)), np.pi)
    return np.where(np.arctan2(poses.margin, poses.height) >= STEADY, np.pi, allowed.min(axis=1))


def alpha_shape_angles(poses: StablePoses, alpha: float | None = None) -> Float[np.ndarray, " m"]:
    """Half-angle (m,) of the cone inscribed in the alpha shape of each basin's starts, radians; the paper's way.

    The starts that settle into a pose, and the pose itself, are taken into its tangent plane by the logarithm. The
    alpha shape is the part of their Delaunay triangulation with circumradii up to ``alpha``; the cone reaches to the
    nearest edge of it.

    Args:
        poses: of the target.
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
    """Distance of the first point from the boundary of the alpha shape; 0 where it does not lie inside."""
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
    # Opposite to the axis all ways are as long; any will do.
    other = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side = np.where(length > 1e-12, across / np.maximum(length, 1e-300), other / np.linalg.norm(other))
    rim = np.cos(cone.half_angle) * axis + np.sin(cone.half_angle) * side
    return np.where(beyond[..., None], rim, x)


def plane_clearance(
    target: Float[np.ndarray, "N 3"], gripper: Float[np.ndarray, "*batch G 3"], x: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch"]:
    """Signed distance of the gripper from the plane with downward normal x that supports the target from below.

    It is h_T(x) − h_C(x), on the exact hulls; negative where the gripper reaches into the plane. H of Proposition 2 is
    this less the margin δ.

    Args:
        target: (N, 3) vertices of the target, metres.
        gripper: (..., G, 3) vertices of the gripper's bodies in the target's frame, metres.
        x: (..., 3) unit directions.
    """
    return (x @ target.T).max(axis=-1) - np.einsum("...gi,...i->...g", gripper, x).max(axis=-1)


def relaxed_release(
    cone: ReleaseCone, target: Float[np.ndarray, "N 3"], gripper: Float[np.ndarray, "K G 3"], delta: float
) -> tuple[Float[np.ndarray, "K 3"], Bool[np.ndarray, " K"]]:
    """Directions in which to let the target go so that each of K grippers clears the plane (Alg. 3, lines 9–12).

    Args:
        cone: of the stable pose.
        target: (N, 3) vertices of the target, metres.
        gripper: (K, G, 3) vertices of the gripper's bodies in the target's frame, metres.
        delta: clearance wanted, metres.

    Returns:
        (K, 3) unit directions x̃ in the cone, the axis where that is clear already, and (K,) whether the gripper clears
        the plane by ``delta``. As the cone is round about the axis, there is no other direction in it where not.
    """
    x = project(cone, perturbed_plane(target, gripper, cone.axis, delta))
    return x, plane_clearance(target, gripper, x) >= delta - _rounding(target)


def perturbed_plane(
    target: Float[np.ndarray, "N 3"],
    gripper: Float[np.ndarray, "K G 3"],
    axis: Float[np.ndarray, " 3"],
    delta: float,
) -> Float[np.ndarray, "K 3"]:
    """The supporting planes nearest to the nominal one that each of K grippers clears by ``delta``: eq. (9), H(x) = 0.

    H ≥ 0 where some vertex v of the target lies below all points g of the gripper by δ, (v − g)·x ≥ δ: for each v that
    is an intersection of caps of the sphere. The nearest point of such an intersection is the nearest point of one cap
    or a crossing of two rims. It is found for each v by adding the cap that is violated most, again and again (each
    time the distance grows, so that it ends), beginning with the v that may give the least tilt; the v whose bounds
    are beyond the best tilt found need not be looked at. So the solution is the nearest one of all, and exact.

    Args:
        target: (N, 3) vertices of the target, metres.
        gripper: (K, G, 3) vertices of the gripper's bodies in the target's frame, metres.
        axis: (3,) unit nominal direction.
        delta: clearance wanted, metres, not negative.

    Returns:
        (K, 3) unit directions x̃: ``axis`` where the plane is clear already, and where no plane tilted by less than 90°
        is (the gripper reaches around the target below it).
    """
    x = np.tile(np.asarray(axis, float), (len(gripper), 1))
    rows = np.flatnonzero(plane_clearance(target, gripper, x) < delta)
    if len(rows):
        x[rows] = _nearest_clear(target, gripper[rows], np.asarray(axis, float), delta)
    return x


_CHUNK = 6
"""Vertices of the target looked at together."""

_ADDITIONS = 16
"""Most caps added one after another; four or five do but for near ties, which are left out then."""


def _nearest_clear(
    target: Float[np.ndarray, "N 3"], gripper: Float[np.ndarray, "K G 3"], axis: Float[np.ndarray, " 3"], delta: float
) -> Float[np.ndarray, "K 3"]:
    count, tolerance = len(gripper), 0.1 * _rounding(target)
    rows = np.arange(count)
    lowest = gripper[rows, (gripper @ axis).argmax(axis=1)]
    first, cosine = _onto_cap(target - lowest[:, None], axis, delta)
    order = np.argsort(-cosine, axis=1)
    best, best_cosine = np.tile(axis, (count, 1)), np.zeros(count)
    for begin in range(0, len(target), _CHUNK):
        # A vertex is worth looking at while its first cap alone does not tilt the plane more than the best so far.
        rows = rows[cosine[rows, order[rows, begin]] > best_cosine[rows]]
        if len(rows) == 0:
            break
        some = order[rows, begin : begin + _CHUNK]
        one = rows[:, None]
        x, found = _through_caps(target[some], gripper[rows], first[one, some], lowest[rows], axis, delta, tolerance)
        value = np.where(found, x @ axis, 0.0)
        winner = value.argmax(axis=1)
        own = np.arange(len(rows))
        better = value[own, winner] > best_cosine[rows]
        best[rows[better]] = x[own, winner][better]
        best_cosine[rows[better]] = value[own, winner][better]
    return best


def _through_caps(
    v: Float[np.ndarray, "K M 3"],
    gripper: Float[np.ndarray, "K G 3"],
    x: Float[np.ndarray, "K M 3"],
    lowest: Float[np.ndarray, "K 3"],
    axis: Float[np.ndarray, " 3"],
    delta: float,
    tolerance: float,
) -> tuple[Float[np.ndarray, "K M 3"], Bool[np.ndarray, "K M"]]:
    """Point nearest to the axis in all caps (v − g)·x ≥ δ, for each v, and whether there is one within 90°.

    ``x`` is the nearest point of the cap of the gripper point ``lowest``.
    """
    k, m = v.shape[:2]
    w = v - lowest[:, None]
    # The one or two caps whose rims x lies on; NaN for none.
    active = np.stack([w, np.full_like(w, np.nan)], axis=2)
    x = x.copy()
    pending = ~np.isnan(x[..., 0])
    found = np.zeros((k, m), bool)
    for _ in range(_ADDITIONS):
        i, j = np.nonzero(pending)
        if len(i) == 0:
            break
        here = x[i, j]
        deepest = gripper[i, np.einsum("ngi,ni->ng", gripper[i], here).argmax(axis=1)]
        new = v[i, j] - deepest
        clear = (new * here).sum(axis=1) >= delta - tolerance
        found[i[clear], j[clear]] = True
        pending[i[clear], j[clear]] = False
        i, j, new = i[~clear], j[~clear], new[~clear]
        if len(i) == 0:
            break
        old = active[i, j]
        alone, _ = _onto_cap(new[:, None], axis, delta)
        points = np.concatenate([alone, *(_rim_crossings(new, old[:, n], delta) for n in (0, 1))], axis=1)
        caps = np.stack([new, old[:, 0], old[:, 1]], axis=1)
        slack = np.einsum("nci,npi->npc", caps, points) - delta
        inside = (np.where(np.isnan(caps[:, None, :, 0]), np.inf, slack) >= -tolerance).all(axis=2)
        value = np.where(inside, points @ axis, -1.0)
        winner = value.argmax(axis=1)
        n = np.arange(len(i))
        x[i, j] = points[n, winner]
        active[i, j, 0] = new
        partner = np.where(winner[:, None] == 0, np.nan, np.where(winner[:, None] <= 2, old[:, 0], old[:, 1]))
        active[i, j, 1] = partner
        pending[i, j] = value[n, winner] > 0
    return x, found


def _onto_cap(
    w: Float[np.ndarray, "K M 3"], axis: Float[np.ndarray, " 3"], delta: float
) -> tuple[Float[np.ndarray, "K M 3"], Float[np.ndarray, "K M"]]:
    """Point of each cap w·x ≥ δ nearest to the axis, and its cosine; NaN and −1 where the cap is empty."""
    length = np.linalg.norm(w, axis=-1)
    safe = np.maximum(length, 1e-300)
    level, along = delta / safe, (w @ axis) / safe
    unit = w / safe[..., None]
    across = axis - along[..., None] * unit
    across /= np.maximum(np.linalg.norm(across, axis=-1), 1e-300)[..., None]
    empty = level >= 1
    inside = along >= level
    x = level[..., None] * unit + np.sqrt(np.maximum(1 - level**2, 0.0))[..., None] * across
    x = np.where(inside[..., None], axis, np.where(empty[..., None], np.nan, x))
    return x, np.where(empty, -1.0, np.where(inside, 1.0, x @ axis))


def _rim_crossings(
    a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"], delta: float
) -> Float[np.ndarray, "n 2 3"]:
    """Both unit x with a·x = b·x = δ; NaN where there is none."""
    aa, bb, ab = (a * a).sum(axis=1), (b * b).sum(axis=1), (a * b).sum(axis=1)
    normal = np.cross(a, b)
    square = (normal * normal).sum(axis=1)
    # A NaN or a negative root stands for rims that do not meet.
    with np.errstate(invalid="ignore", divide="ignore"):
        level = (delta * ((bb - ab)[:, None] * a + (aa - ab)[:, None] * b)) / square[:, None]
        rise = np.sqrt((1 - (level * level).sum(axis=1)) / square)[:, None] * normal
    return np.stack([level + rise, level - rise], axis=1)


def _rounding(target: Float[np.ndarray, "N 3"]) -> float:
    """What clearances computed from these vertices may be off by, metres."""
    return 1e-9 * float(np.abs(target).max())


def _angle(a: Float[np.ndarray, "*batch 3"], b: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
    """Angle between unit vectors, exact near 0 and π too, radians."""
    return 2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
