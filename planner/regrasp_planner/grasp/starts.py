"""Where GraspGen starts: axes to close along, approaches about them, and a gripper reduced to few bodies.

A start is worked out on the target alone, in closed form: the closing axis is a critical direction of the width
function, and lines cast along the axis and along the approach tell where the pads touch and how far the gripper can be
pushed over the target. So the fingers of a start touch on opposite sides; only the obstacles are left to look after.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from regrasp_planner.geometry.hull import clip_lines, facets, hull_planes, qhull
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.robot.gripper import GripperBodies, finger_coordinate, moved_points, outer_corners, reduce_gripper
from regrasp_planner.robot.model import Gripper


def closing_axes(
    hull: Float[np.ndarray, "N 3"], max_width: float, max_axes: int, lean: float = 0.0
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
    """Axes along which a convex body can be taken between two parallel pads: the local minima of its width function.

    At a critical direction of w(x) = h(x) + h(−x) the support points s(x) and s(−x) differ by a multiple of x: they
    are antipodal, with normals ±x. Now w is itself a support function, that of the difference body {a − b}; so, as
    for stable poses, its minima are the facets of that body which the foot of its centre lies inside of. They are
    exact, and there is nothing to iterate. Where minima crowd (round a can, all over a ball) some are picked apart.

    Friction holds where the line between the contacts leans against their normals, too. Facets outside of which the
    foot lies come after the minima, as long as the line to the edge that it lies farthest beyond leans by less than
    ``lean``.

    Args:
        hull: (N, 3) the body's vertices.
        max_width: widest graspable width, metres.
        max_axes: most axes to give.
        lean: largest angle between an axis and that line, radians; 0 for the minima alone.

    Returns:
        (m, 3) unit axes, the minima narrowest first, and (m,) widths, metres. Empty if the body is too wide everywhere.
    """
    corners = hull[qhull(hull).vertices]
    differences = (corners[:, None] - corners[None]).reshape(-1, 3)
    faces = facets(qhull(differences), np.zeros(3))
    leaning = np.maximum(np.arctan2(-faces.margins, faces.heights), 0.0)
    taken = np.flatnonzero(((faces.margins > 0) | (leaning < lean)) & (faces.heights <= max_width))
    # Of each axis one of the two directions, and by width to the micrometre, so that rounding decides nothing.
    order = taken[np.lexsort((*faces.normals[taken].T, np.round(faces.heights[taken], 6), leaning[taken].round(3)))]
    axes, widths = faces.normals[order], faces.heights[order]
    chosen: list[int] = []
    along = np.abs(axes @ axes.T)
    # Finest grouping first; a coarser one only where there are more axes than wanted.
    for degrees in (3.0, 8.0, 15.0, 25.0, 40.0):
        chosen, left = [], np.ones(len(axes), bool)
        while left.any():
            chosen.append(int(left.argmax()))
            left &= along[chosen[-1]] < np.cos(np.radians(degrees))
            left[chosen[-1]] = False
        if len(chosen) <= max_axes:
            break
    chosen = chosen[:max_axes]
    return axes[chosen], widths[chosen]


class Starts(NamedTuple):
    """Start grasps.

    Attributes:
        poses: (K, 7) gripper poses in the target's frame.
        thetas: (K,) finger coordinates at which the pads touch.
        depths: (K,) distance of the grasp centre from the faces of the part taken that the fingers do not press on,
            metres; positive inside.
        taken: (K,) index of the part of the target that is between the pads.
    """

    poses: Float[np.ndarray, "K 7"]
    thetas: Float[np.ndarray, " K"]
    depths: Float[np.ndarray, " K"]
    taken: Int[np.ndarray, " K"]

    @staticmethod
    def none() -> Starts:
        """No starts at all."""
        return Starts(np.zeros((0, 7)), np.zeros(0), np.zeros(0), np.zeros(0, int))

    @staticmethod
    def concatenate(several: Sequence[Starts]) -> Starts:
        """All starts of several."""
        return Starts(*(np.concatenate(leaves) for leaves in zip(*several, strict=True)))


def grasp_starts(
    pieces: Sequence[Float[np.ndarray, "N 3"]],
    taken: int,
    part: Float[np.ndarray, "M 3"],
    axes: Float[np.ndarray, "m 3"],
    gripper: Gripper,
    angles: int,
    margin: float,
) -> Starts:
    """Start grasps of one part of the target: closing axes, approach angles about each, offsets across and along.

    The gripper is pushed over the part until the grasp centre is level with its middle, or as far as palm and
    fingertips go; and once more only so far that the pads hold on. Long parts are also taken off their middle.

    Args:
        pieces: vertices of the target's convex pieces, metres.
        taken: index of the part, which the starts carry.
        part: (M, 3) vertices of the convex part between the pads.
        axes: (m, 3) closing axes.
        gripper: the gripper.
        angles: approach angles about each axis.
        margin: clearance of palm and fingertips from the target, metres.

    Returns:
        `Starts`. Those whose pads would not meet the part, or are too far apart for the gripper, are left out.
    """
    reduced = reduce_gripper(gripper)
    width_axis = np.asarray(gripper.width_axis)
    tool = np.stack([width_axis, np.asarray(gripper.approach_axis)], axis=1)
    tool = np.column_stack([tool, np.cross(tool[:, 0], tool[:, 1])])
    frames, origins = _approaches(part, axes, angles, 0.5 * float(gripper.max_opening))
    turns = frames @ tool.T
    closing, approach = frames[:, :, 0], frames[:, :, 1]

    # How far the gripper goes forward until the palm or an opened fingertip meets the target.
    local = part @ frames
    low, high = local.min(axis=1), local.max(axis=1)
    closed = finger_coordinate(gripper, (high - low)[:, 0])
    opened = np.minimum(closed + margin * reduced.travel, float(gripper.upper))
    probes = origins[:, None] + _fronts(gripper, reduced, opened) @ turns.swapaxes(1, 2)
    limit = np.min([clip_lines(probes, approach, hull_planes(each))[0].min(axis=1) for each in pieces], axis=0)
    limit = np.minimum(limit, _under_palm(np.concatenate(pieces), origins, turns, reduced, gripper)) - margin
    deep = np.minimum(0.0, limit)
    shallow = low[:, 1] - (origins * approach).sum(axis=1) + 0.6 * reduced.tip_length
    room = np.flatnonzero(shallow < deep - 0.1 * float(gripper.max_opening))
    index = np.concatenate([np.arange(len(deep)), room, room])
    forward = np.concatenate([deep, shallow[room], 0.5 * (deep + shallow)[room]])
    origins = origins[index] + forward[:, None] * approach[index]

    # Where the pads touch: the outermost points of the part between them, where a round pad is set back in between.
    planes = hull_planes(part)
    lines, recess = _pad_lines(reduced.pads[0], width_axis)
    lines = moved_points(lines, np.asarray(gripper.screws)[0], closed[index])
    lines = lines - (lines @ width_axis)[..., None] * width_axis
    over = origins[:, None] + lines @ turns[index].swapaxes(1, 2)
    enter, leave = clip_lines(over, closing[index], planes)
    first, last = (enter + recess).min(axis=1), (leave - recess).max(axis=1)
    fits = np.flatnonzero((last > first) & (last - first <= float(gripper.max_opening)))
    index, first, last = index[fits], first[fits], last[fits]
    origins = origins[fits] + (0.5 * (first + last))[:, None] * closing[index]
    facing = np.abs(closing[index] @ planes[:, :3].T) > 0.9
    depths = np.where(facing, np.inf, planes[:, 3] - origins @ planes[:, :3].T).min(axis=1)
    quaternions = Rotation.from_matrix(turns[index]).as_quat(scalar_first=True).reshape(-1, 4)
    poses = np.concatenate([quaternions, origins], axis=1)
    return Starts(poses, finger_coordinate(gripper, last - first), depths, np.full(len(index), taken))


def uniform_starts(hull: Float[np.ndarray, "N 3"], gripper: Gripper, count: int, seed: int) -> Starts:
    """Plain multi-start: grippers turned at random, half open, their palms just off the middle of the target.

    Args:
        hull: (N, 3) the target's vertices.
        gripper: the gripper.
        count: number of starts.
        seed: of their orientations.
    """
    turns = Rotation.random(count, rng=np.random.default_rng(seed))
    approach = turns.apply(np.asarray(gripper.approach_axis))
    middle = 0.5 * (hull.min(axis=0) + hull.max(axis=0))
    reach = (hull @ approach.T).min(axis=0) - approach @ middle
    back = np.minimum(0.0, reach + reduce_gripper(gripper).finger_length)
    poses = np.concatenate([turns.as_quat(scalar_first=True), middle + back[:, None] * approach], axis=1)
    half = 0.5 * (float(gripper.lower) + float(gripper.upper))
    return Starts(poses, np.full(count, half), np.zeros(count), np.zeros(count, int))


def _approaches(
    piece: Float[np.ndarray, "N 3"], axes: Float[np.ndarray, "m 3"], angles: int, long: float
) -> tuple[Float[np.ndarray, "K 3 3"], Float[np.ndarray, "K 3"]]:
    """Frames (closing, approach, across) and points level with the middle of the piece, the same number per axis."""
    turns = np.arange(angles) * (2 * np.pi / angles)
    frames: list[np.ndarray] = []
    origins: list[np.ndarray] = []
    for axis in axes:
        other = np.eye(3)[np.argmin(np.abs(axis))]
        first = np.cross(axis, other) / np.linalg.norm(np.cross(axis, other))
        approach = np.outer(np.cos(turns), first) + np.outer(np.sin(turns), np.cross(axis, first))
        frame = np.stack([np.broadcast_to(axis, approach.shape), approach, np.cross(axis, approach)], axis=2)
        local = piece @ frame
        low, high = local.min(axis=1), local.max(axis=1)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        # Off the middle by as much as leaves the pads on the piece, at least where it is longer than the gripper.
        off = np.where(half[:, 2] > long, 0.7, 0.6) * half[:, 2]
        for offset in (0.0 * off, 0.5 * off, -0.5 * off, off, -off):
            frames.append(frame)
            origins.append(np.einsum("kij,kj->ki", frame, middle + offset[:, None] * [0.0, 0.0, 1.0]))
    return np.concatenate(frames), np.concatenate(origins)


def _fronts(gripper: Gripper, reduced: GripperBodies, opened: Float[np.ndarray, " K"]) -> Float[np.ndarray, "K P 3"]:
    """Points on the fronts of the palm and of both fingers, opened to each θ, in the gripper frame."""
    axis = np.asarray(gripper.approach_axis)
    palm, *fingers = (_face(outer_corners(reduced.hand[k]), axis) for k in range(3))
    moved = [
        moved_points(front, screw, opened) for front, screw in zip(fingers, np.asarray(gripper.screws), strict=True)
    ]
    return np.concatenate([np.broadcast_to(palm, (len(opened), *palm.shape)), *moved], axis=1)


def _under_palm(
    corners: Float[np.ndarray, "N 3"],
    origins: Float[np.ndarray, "K 3"],
    turns: Float[np.ndarray, "K 3 3"],
    reduced: GripperBodies,
    gripper: Gripper,
) -> Float[np.ndarray, " K"]:
    """How far the gripper goes forward until the palm meets the first of the target's corners in front of it."""
    axis = np.asarray(gripper.approach_axis)
    palm = outer_corners(reduced.hand[0])
    local = (corners - origins[:, None]) @ turns
    level = 1.0 - np.abs(axis)
    inside = ((local >= palm.min(axis=0)) & (local <= palm.max(axis=0)) | (level < 0.5)).all(axis=2)
    return np.where(inside, local @ axis + reduced.finger_length, np.inf).min(axis=1)


def _face(vertices: Float[np.ndarray, "N 3"], normal: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "9 3"]:
    """A grid of 3 × 3 points over the outermost extent along ``normal``, spread over the body's width across it."""
    other = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(normal, other) / np.linalg.norm(np.cross(normal, other))
    frame = np.stack([first, np.cross(normal, first), normal], axis=1)
    local = vertices @ frame
    low, high = local.min(axis=0), local.max(axis=0)
    grid = np.stack(np.meshgrid(*np.linspace(low[:2], high[:2], 3).T, [high[2]], indexing="ij"), axis=-1)
    return grid.reshape(-1, 3) @ frame.T


def _pad_lines(
    pad: ConvexBody, normal: Float[np.ndarray, " 3"]
) -> tuple[Float[np.ndarray, "P 3"], Float[np.ndarray, " P"]]:
    """Points spread over a pad's face, and how far its surface lies there behind its foremost point, metres."""
    vertices, radius = pad.hull_vertices(), float(pad.radius)
    if radius == 0:
        return _face(vertices, normal), np.zeros(9)
    other = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(normal, other) / np.linalg.norm(np.cross(normal, other))
    lateral = np.stack([first, np.cross(normal, first)])
    low, high = (vertices @ lateral.T).min(axis=0), (vertices @ lateral.T).max(axis=0)
    # Points of the core no further apart than half the radius, and about each as much of the sweep as a side touches
    # that slants by up to 30°.
    cores = [np.linspace(a, b, 1 + round(2 * (b - a) / radius)) for a, b in zip(low, high, strict=True)]
    core = np.stack(np.meshgrid(*cores, indexing="ij"), axis=-1).reshape(-1, 2)
    offsets = radius * np.array([[0, 0], [-0.5, 0], [-0.25, 0], [0.25, 0], [0.5, 0], [0, -0.5], [0, 0.5]])
    points = (core[:, None] + offsets).reshape(-1, 2)
    recess = radius - np.sqrt(radius**2 - (offsets**2).sum(axis=1))
    front = (vertices @ normal).max()
    return points @ lateral + front * normal, np.tile(recess, len(core))
