"""Where GraspGen starts: a gripper reduced to few bodies, axes to close along, and approaches about them."""

from __future__ import annotations

import weakref
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from regrasp_planner.geometry.hull import facets, qhull
from regrasp_planner.geometry.support import ConvexBody, support_value
from regrasp_planner.robot import Gripper


def _hull_of(bodies: ConvexBody, indices: np.ndarray) -> ConvexBody:
    radius = float(np.min([bodies[int(i)].radius for i in indices]))
    points = []
    for i in indices:
        body = bodies[int(i)]
        # The hull of the swept pieces, with the smallest common radius kept as a sweep and the rest as a box about it.
        extra = float(body.radius) - radius
        corners = np.array(np.meshgrid(*[[-extra, extra]] * 3)).reshape(3, -1).T if extra > 0 else np.zeros((1, 3))
        points.append((body.hull_vertices()[:, None] + corners).reshape(-1, 3))
    return ConvexBody.from_vertices(np.concatenate(points), radius=radius, max_vertices=16)


class GripperBodies(NamedTuple):
    """A gripper reduced to what GraspGen needs: hulls of palm and fingers, pads, free length of the fingers."""

    hand: ConvexBody
    pads: ConvexBody
    finger_length: float
    tip_length: float


_REDUCED: dict[int, GripperBodies] = {}
"""Results of `reduce_gripper` by identity of the gripper, dropped with it."""


def reduce_gripper(gripper: Gripper) -> GripperBodies:
    """Convex hulls of the palm and of each finger, stacked, and the two pads; computed once per gripper.

    ``finger_length`` is the distance from the palm to the gripper frame's origin along the approach axis,
    and ``tip_length`` how far the fingers reach beyond it, metres.
    """
    if id(gripper) in _REDUCED:
        return _REDUCED[id(gripper)]
    owner = np.asarray(gripper.finger_of)
    hulls = [_hull_of(gripper.palm, np.arange(gripper.palm.batch_size))]
    hulls += [_hull_of(gripper.fingers, np.flatnonzero(owner == k)) for k in (0, 1)]
    pads = [gripper.fingers[int(i)] for i in np.asarray(gripper.contact)]
    approach = np.asarray(gripper.approach_axis)
    palm_front = float(support_value(hulls[0], jnp.asarray(approach)))
    tip = max(float(support_value(hull, jnp.asarray(approach))) for hull in hulls[1:])
    reduced = GripperBodies(ConvexBody.stack(hulls), ConvexBody.stack(pads), -palm_front, tip)
    _REDUCED[id(gripper)] = reduced
    weakref.finalize(gripper, _REDUCED.pop, id(gripper), None)
    return reduced


def closing_axes(
    hull: Float[np.ndarray, "N 3"], max_width: float, max_axes: int
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
    """Axes along which the target can be taken between two parallel pads: the local minima of its width function.

    At a critical direction of w(x) = h(x) + h(−x) the support points s(x) and s(−x) differ by a multiple of x: they
    are antipodal, with normals ±x. Now w is itself a support function, that of the difference body {a − b}; so, as
    for stable poses, its minima are the facets of that body which the foot of its centre lies inside of. They are
    exact, and there is nothing to iterate. Where minima crowd (round a can, all over a ball) some are picked apart.

    Args:
        hull: (N, 3) the target's vertices.
        max_width: widest graspable width, metres.
        max_axes: most axes to give.

    Returns:
        (m, 3) unit axes, narrowest first, and (m,) widths, metres. Empty if the target is too wide everywhere.
    """
    corners = hull[qhull(hull).vertices]
    differences = (corners[:, None] - corners[None]).reshape(-1, 3)
    faces = facets(qhull(differences), np.zeros(3))
    taken = np.flatnonzero((faces.margins > 0) & (faces.heights <= max_width))
    # Of each axis one of the two directions, and by width to the micrometre, so that rounding decides nothing.
    order = taken[np.lexsort((*faces.normals[taken].T, np.round(faces.heights[taken], 6)))]
    axes, widths = faces.normals[order], faces.heights[order]
    chosen: list[int] = []
    # Finest grouping first; a coarser one only where there are more axes than wanted.
    for degrees in (3.0, 8.0, 15.0, 25.0, 40.0):
        chosen = []
        for i in range(len(axes)):
            if all(abs(axes[i] @ axes[j]) < np.cos(np.radians(degrees)) for j in chosen):
                chosen.append(i)
        if len(chosen) <= max_axes:
            break
    chosen = chosen[:max_axes]
    return axes[chosen], widths[chosen]


def _perpendicular(axis: np.ndarray) -> np.ndarray:
    other = np.eye(3)[np.argmin(np.abs(axis))]
    first = np.cross(axis, other)
    return first / np.linalg.norm(first)


def grasp_starts(
    hull: Float[np.ndarray, "N 3"], axes: Float[np.ndarray, "m 3"], gripper: Gripper, angles: int, margin: float
) -> tuple[Float[np.ndarray, "K 7"], Float[np.ndarray, " K"]]:
    """Start grasps: each closing axis, approach angles about it, and a few offsets across the fingers.

    The gripper is pushed as deep over the target as its palm allows, at most until the grasp centre is level with the
    middle of the target; slender targets are also taken off their middle, to either side.

    Args:
        hull: (N, 3) the target's vertices.
        axes: (m, 3) closing axes.
        gripper: the gripper.
        angles: approach angles about each axis.
        margin: clearance of the palm from the target, metres.

    Returns:
        (K, 7) gripper poses in the target's frame and (K,) finger coordinates.
    """
    reduced = reduce_gripper(gripper)
    frame = np.stack([np.asarray(gripper.width_axis), np.asarray(gripper.approach_axis)], axis=1)
    frame = np.column_stack([frame, np.cross(frame[:, 0], frame[:, 1])])
    turns = np.arange(angles) * (2 * np.pi / angles)
    half_opening = 0.5 * float(gripper.max_opening)
    frames: list[np.ndarray] = []
    origins: list[np.ndarray] = []
    thetas: list[float] = []
    for axis in axes:
        high, low = (hull @ axis).max(), (hull @ axis).min()
        first = _perpendicular(axis)
        approach = np.outer(np.cos(turns), first) + np.outer(np.sin(turns), np.cross(axis, first))
        across = np.cross(axis, approach)
        along, sideways = hull @ approach.T, hull @ across.T
        # Depth of the grasp centre along the approach, limited by the palm touching the nearest point.
        middle = 0.5 * (along.max(0) + along.min(0))
        depth = np.minimum(middle, along.min(0) + reduced.finger_length - margin)
        center, half = 0.5 * (sideways.max(0) + sideways.min(0)), 0.5 * (sideways.max(0) - sideways.min(0))
        for k in range(angles):
            offsets = (0.0,) if half[k] < half_opening else (0.0, 0.45 * half[k], -0.45 * half[k])
            for offset in offsets:
                level = 0.5 * (high + low) * axis
                origins.append(level + depth[k] * approach[k] + (center[k] + offset) * across[k])
                frames.append(np.column_stack([axis, approach[k], across[k]]) @ frame.T)
                thetas.append(_theta_of_width(gripper, high - low))
    quaternions = Rotation.from_matrix(np.array(frames)).as_quat(scalar_first=True)
    return np.concatenate([quaternions, np.array(origins)], axis=1), np.array(thetas)


def _theta_of_width(gripper: Gripper, width: float) -> float:
    """Finger coordinate at which the pads are ``width`` apart, by linear interpolation between the limits."""
    share = width / float(gripper.max_opening)
    low, high = float(gripper.lower), float(gripper.upper)
    return float(np.clip(low + share * (high - low), low, high))
