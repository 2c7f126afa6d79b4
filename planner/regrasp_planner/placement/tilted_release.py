"""Non-static release (GraspGen⁺): tilt the plane under the target, within the basin, until the gripper clears it.

If the gripper would reach into the ground under a target in its stable pose, the target is released tilted and settles
into the pose by itself (the paper's Alg. 3). That takes three things: cones of directions that settle into each pose
(`basins`), the supporting plane nearest to the nominal one that the gripper clears (Prop. 2, eq. (9)), and a check that
the open fingers do not block the settling target.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from regrasp_planner.geometry.hull import hull_planes, qhull
from regrasp_planner.placement.basins import ReleaseCone, project

SETTLING_STEPS = 4
"""Angles checked between the release and the stable pose."""

BLOCKED = -0.1
"""Least `settling_clearance` of the fingers, as a share of the gripper's opening, at which a release counts as free.

The target pushes past a finger that it only brushes. In MuJoCo, of 164 tilted releases from a Panda's hand (80 mm) with
a clearance of −8 mm or more all settled as predicted; of 66 with less, 73 %. The palm does no harm: it retreats first.
"""


def plane_clearance(
    target: Float[np.ndarray, "N 3"], gripper: Float[np.ndarray, "*batch G 3"], x: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch"]:
    """Signed distance of the gripper from the plane with downward normal x that supports the target from below.

    It is h_T(x) − h_C(x) on the exact hulls, negative if the gripper reaches into the plane. Less the margin δ, it is H
    of Proposition 2.

    Args:
        target: (N, 3) vertices of the target, metres.
        gripper: (..., G, 3) vertices of the gripper's bodies in the target's frame, metres.
        x: (..., 3) unit directions.
    """
    return (x @ target.T).max(axis=-1) - np.einsum("...gi,...i->...g", gripper, x).max(axis=-1)


def relaxed_release(
    cone: ReleaseCone, target: Float[np.ndarray, "N 3"], gripper: Float[np.ndarray, "K G 3"], delta: float
) -> tuple[Float[np.ndarray, "K 3"], Bool[np.ndarray, " K"]]:
    """Release directions in which each of K grippers clears the plane under the target (Alg. 3, lines 9–12).

    Args:
        cone: cone of the stable pose.
        target: (N, 3) vertices of the target, metres.
        gripper: (K, G, 3) vertices of the gripper's bodies in the target's frame, metres.
        delta: clearance wanted, metres.

    Returns:
        (K, 3) unit directions x̃ in the cone, the axis if it is clear already, and (K,) whether the gripper clears the
        plane by ``delta``. If not, no direction in the cone does, as the cone is round about the axis.
    """
    x = project(cone, perturbed_plane(target, gripper, cone.axis, delta, within=cone.half_angle))
    return x, plane_clearance(target, gripper, x) >= delta - _rounding(target)


def settling_clearance(
    pieces: Sequence[Float[np.ndarray, "N 3"]],
    bodies: Sequence[Float[np.ndarray, "K G 3"]],
    axis: Float[np.ndarray, " 3"],
    x: Float[np.ndarray, "K 3"],
) -> Float[np.ndarray, " K"]:
    """Least clearance of open fingers from the target while it settles from release directions ``x`` to ``axis``.

    The target turns about its lowest corner; the gripper stays where it is. At each of `SETTLING_STEPS` angles on the
    way, the distance is bounded from below along the facet normals of both. A finger in the way holds the target up,
    and drags or topples it on its retreat; see `BLOCKED`.

    Args:
        pieces: convex pieces of the target, (N, 3) vertices each, metres.
        bodies: the opened fingers; for each (K, G, 3) vertices of the same convex body at K poses in the target's
            frame, in the same order, metres.
        axis: (3,) unit stable direction.
        x: (K, 3) unit release directions.

    Returns:
        (K,) least signed clearance, metres.
    """
    corners = np.concatenate(list(pieces))
    pivot = corners[(x @ corners.T).argmax(axis=1)][:, None]
    turn = np.cross(x, axis)
    sine = np.linalg.norm(turn, axis=1)
    turn *= (np.arctan2(sine, x @ axis) / np.maximum(sine, 1e-12))[:, None]
    piece_normals = [hull_planes(piece)[:, :3] for piece in pieces]
    body_normals = [_facet_normals(body) for body in bodies]
    least = np.full(len(x), np.inf)
    for step in range(1, SETTLING_STEPS + 1):
        # In the target's frame, the gripper turns the other way about the same corner.
        back = np.swapaxes(Rotation.from_rotvec(step / SETTLING_STEPS * turn).as_matrix(), 1, 2)
        for body, normals in zip(bodies, body_normals, strict=True):
            points, turned = (body - pivot) @ back + pivot, normals @ back
            support = np.einsum("kfi,kgi->kfg", turned, points).max(axis=2)
            for piece, faces in zip(pieces, piece_normals, strict=True):
                off_piece = (points @ faces.T).min(axis=1) - (piece @ faces.T).max(axis=0)
                off_body = (turned @ piece.T).min(axis=2) - support
                least = np.minimum(least, np.maximum(off_piece.max(axis=1), off_body.max(axis=1)))
    return least


def _facet_normals(bodies: Float[np.ndarray, "K N 3"]) -> Float[np.ndarray, "K F 3"]:
    """Outward unit normals of the facets of a hull at K poses; coplanar facets give one."""
    hull = qhull(bodies[0])
    triangles = hull.simplices[np.unique(hull.equations.round(6), axis=0, return_index=True)[1]]
    a, b, c = (bodies[:, triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    inside = bodies.mean(axis=1, keepdims=True) - a
    return -np.sign((normals * inside).sum(axis=2, keepdims=True)) * normals


def perturbed_plane(
    target: Float[np.ndarray, "N 3"],
    gripper: Float[np.ndarray, "K G 3"],
    axis: Float[np.ndarray, " 3"],
    delta: float,
    within: float = 0.5 * np.pi,
) -> Float[np.ndarray, "K 3"]:
    """The supporting planes nearest to the nominal one that each of K grippers clears by ``delta``: eq. (9), H(x) = 0.

    H ≥ 0 if some vertex v of the target lies below all points g of the gripper by δ: (v − g)·x ≥ δ, which for each v is
    an intersection of caps of the sphere. The nearest point of such an intersection is the nearest point of one cap or
    a crossing of two rims. For each v, the most violated cap is added until none is violated; the distance grows with
    each, so this ends. Vertices come in order of the least tilt they may allow, and those that cannot beat the best
    tilt so far are skipped. So the solution is exact and the nearest of all.

    Args:
        target: (N, 3) vertices of the target, metres.
        gripper: (K, G, 3) vertices of the gripper's bodies in the target's frame, metres.
        axis: (3,) unit nominal direction.
        delta: clearance wanted, metres, not negative.
        within: greatest tilt considered, radians, at most 90°.

    Returns:
        (K, 3) unit directions x̃, ``axis`` if its plane is clear already. If no plane tilted by less than ``within`` is
        clear (the gripper reaches around the target below it), the direction in which at least the gripper's lowest
        point is clear, or ``axis`` if there is none.
    """
    x = np.tile(np.asarray(axis, float), (len(gripper), 1))
    rows = np.flatnonzero(plane_clearance(target, gripper, x) < delta)
    if len(rows):
        x[rows] = _nearest_clear(target, gripper[rows], np.asarray(axis, float), delta, float(np.cos(within)))
    return x


_CHUNK = 3
"""Vertices of the target tried together."""

_ADDITIONS = 16
"""Most caps added for one vertex; four or five suffice except for near ties, which are given up."""


def _nearest_clear(
    target: Float[np.ndarray, "N 3"],
    gripper: Float[np.ndarray, "K G 3"],
    axis: Float[np.ndarray, " 3"],
    delta: float,
    least_cosine: float,
) -> Float[np.ndarray, "K 3"]:
    tolerance = 0.1 * _rounding(target)
    lowest = gripper[np.arange(len(gripper)), (gripper @ axis).argmax(axis=1)]
    # Upper bound of the cosine that each vertex allows; a vertex is tried while that exceeds the best so far.
    bound = _cap_cosines(target, lowest, axis, delta)
    alone, value = _onto_cap((target[bound.argmax(axis=1)] - lowest)[:, None], axis, delta)
    best = np.where(value > 0, alone[:, 0], axis)
    best_cosine = np.full(len(gripper), least_cosine)
    while len(rows := np.flatnonzero(bound.max(axis=1) > best_cosine)):
        chosen = np.argpartition(-bound[rows], min(_CHUNK, len(target) - 1), axis=1)[:, :_CHUNK]
        x, found, active = _through_caps(target[chosen], gripper[rows], lowest[rows], axis, delta, tolerance)
        value = np.where(found, x @ axis, -1.0)
        own, winner = np.arange(len(rows)), value.argmax(axis=1)
        better = value[own, winner] > best_cosine[rows]
        best[rows[better]] = x[own, winner][better]
        best_cosine[rows[better]] = value[own, winner][better]
        bound[rows[:, None], chosen] = -1.0
        # The gripper points that bind this solution also bind other vertices.
        for binding in np.moveaxis(target[chosen][own, winner][:, None] - active[own, winner], 1, 0):
            tighter = _cap_cosines(target, binding, axis, delta)
            bound[rows] = np.fmin(bound[rows], tighter)
    return best


def _cap_cosines(
    target: Float[np.ndarray, "N 3"], g: Float[np.ndarray, "K 3"], axis: Float[np.ndarray, " 3"], delta: float
) -> Float[np.ndarray, "K N"]:
    """Cosine of the tilt to the nearest point of each cap (v − g)·x ≥ δ; −1 where the cap is empty."""
    square = (target * target).sum(axis=1) - 2 * g @ target.T + (g * g).sum(axis=1)[:, None]
    length = np.sqrt(np.maximum(square, 1e-300))
    along, level = (target @ axis - (g @ axis)[:, None]) / length, delta / length
    # Angle between w and the axis, less that between w and the rim of its cap.
    to_rim = along * level + np.sqrt(np.maximum((1 - along**2) * (1 - level**2), 0.0))
    return np.where(level >= 1, -1.0, np.where(along >= level, 1.0, to_rim))


def _through_caps(
    v: Float[np.ndarray, "K M 3"],
    gripper: Float[np.ndarray, "K G 3"],
    lowest: Float[np.ndarray, "K 3"],
    axis: Float[np.ndarray, " 3"],
    delta: float,
    tolerance: float,
) -> tuple[Float[np.ndarray, "K M 3"], Bool[np.ndarray, "K M"], Float[np.ndarray, "K M 2 3"]]:
    """Point nearest to the axis in all caps (v − g)·x ≥ δ, for each v, and whether there is one within 90°.

    The first cap is that of the gripper point ``lowest``. The third array holds v − g of the caps that bind, or NaN.
    """
    w = v - lowest[:, None]
    x, value = _onto_cap(w, axis, delta)
    # The one or two caps whose rims x lies on; NaN for none.
    active = np.stack([w, np.full_like(w, np.nan)], axis=2)
    pending = value > 0
    found = np.zeros_like(pending)
    for _ in range(_ADDITIONS):
        rows = np.flatnonzero(pending.any(axis=1))
        if len(rows) == 0:
            break
        deepest = np.zeros(pending.shape, int)
        deepest[rows] = (gripper[rows] @ np.swapaxes(x[rows], 1, 2)).argmax(axis=1)
        i, j = np.nonzero(pending)
        here = x[i, j]
        new = v[i, j] - gripper[i, deepest[i, j]]
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
    return x, found, active


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
    # Rims that do not meet give NaN.
    with np.errstate(invalid="ignore", divide="ignore"):
        level = (delta * ((bb - ab)[:, None] * a + (aa - ab)[:, None] * b)) / square[:, None]
        rise = np.sqrt((1 - (level * level).sum(axis=1)) / square)[:, None] * normal
    return np.stack([level + rise, level - rise], axis=1)


def _rounding(target: Float[np.ndarray, "N 3"]) -> float:
    """Rounding error of clearances computed from these vertices, metres."""
    return 1e-9 * float(np.abs(target).max())
