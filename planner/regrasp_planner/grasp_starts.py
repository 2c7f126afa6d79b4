"""Where GraspGen starts: axes to close along, approaches about them, and a gripper reduced to few bodies.

A start is worked out on the target alone, in closed form: the closing axis is a critical direction of the width
function, and lines cast along the axis and along the approach tell where the pads touch and how far the gripper can be
pushed over the target. So the fingers of a start touch on opposite sides; only the obstacles are left to look after.
"""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import RigidTransform, Rotation

from regrasp_planner.geometry.hull import facets, qhull
from regrasp_planner.geometry.support import ConvexBody, support_value
from regrasp_planner.robot import Gripper

CLIPPED = 2**15
"""Crossings of lines and planes worked out at once."""


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


def outer_corners(body: ConvexBody) -> Float[np.ndarray, "N 3"]:
    """Points whose hull holds the body with its sweep: its vertices, and where it is swept a cube about each."""
    vertices, radius = body.hull_vertices(), float(body.radius)
    if radius == 0:
        return vertices
    cube = np.array(np.meshgrid(*[[-radius, radius]] * 3)).reshape(3, -1).T
    return (vertices[:, None] + cube).reshape(-1, 3)


class GripperBodies(NamedTuple):
    """A gripper reduced to what GraspGen needs.

    Attributes:
        hand: convex hulls of the palm and of each finger at θ = 0, stacked, in the gripper frame.
        pads: the two contact bodies at θ = 0, stacked, in the gripper frame.
        finger_length: distance from the palm to the gripper frame's origin along the approach axis, metres.
        tip_length: how far the fingers reach beyond it, metres.
        thetas, gaps: (16,) finger coordinates over their range, and how far the pads are apart there, metres.
        travel: by how much θ grows per metre that each finger moves outwards, on average over its range; 1 where the
            fingers slide and θ is their travel.
    """

    hand: ConvexBody
    pads: ConvexBody
    finger_length: float
    tip_length: float
    thetas: Float[np.ndarray, " 16"]
    gaps: Float[np.ndarray, " 16"]
    travel: float


_REDUCED: dict[int, GripperBodies] = {}
"""Results of `reduce_gripper` by identity of the gripper, dropped with it."""


def reduce_gripper(gripper: Gripper) -> GripperBodies:
    """Convex hulls of the palm and of each finger, and the two pads; computed once per gripper."""
    if id(gripper) in _REDUCED:
        return _REDUCED[id(gripper)]
    owner = np.asarray(gripper.finger_of)
    hulls = [_hull_of(gripper.palm, np.arange(gripper.palm.batch_size))]
    hulls += [_hull_of(gripper.fingers, np.flatnonzero(owner == k)) for k in (0, 1)]
    pads = [gripper.fingers[int(i)] for i in np.asarray(gripper.contact)]
    approach = np.asarray(gripper.approach_axis)
    palm_front = float(support_value(hulls[0], jnp.asarray(approach)))
    tip = max(float(support_value(hull, jnp.asarray(approach))) for hull in hulls[1:])
    thetas = np.linspace(float(gripper.lower), float(gripper.upper), 16)
    gaps = _pad_gaps(gripper, pads, thetas)
    travel = round(float(2 * (thetas[-1] - thetas[0]) / (gaps[-1] - gaps[0])), 9)
    reduced = GripperBodies(ConvexBody.stack(hulls), ConvexBody.stack(pads), -palm_front, tip, thetas, gaps, travel)
    _REDUCED[id(gripper)] = reduced
    weakref.finalize(gripper, _REDUCED.pop, id(gripper), None)
    return reduced


def _pad_gaps(gripper: Gripper, pads: Sequence[ConvexBody], thetas: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    """Distance of the pads along the width axis at finger coordinates, metres."""
    axis = np.asarray(gripper.width_axis)
    along = [
        _moved(pad.hull_vertices(), screw, thetas) @ axis
        for pad, screw in zip(pads, np.asarray(gripper.screws), strict=True)
    ]
    if along[0].mean() > along[1].mean():
        along.reverse()
    swept = sum(float(pad.radius) for pad in pads)
    return along[1].min(axis=1) - along[0].max(axis=1) - swept


def finger_coordinate(gripper: Gripper, width: Float[np.ndarray, "*K"] | float) -> Float[np.ndarray, "*K"]:
    """θ at which the pads are ``width`` metres apart; the end of its range for what the gripper can not do."""
    reduced = reduce_gripper(gripper)
    return np.asarray(np.interp(width, reduced.gaps, reduced.thetas))


def pad_gap(gripper: Gripper, theta: float) -> float:
    """How far the pads are apart at θ, metres."""
    reduced = reduce_gripper(gripper)
    return float(np.interp(theta, reduced.thetas, reduced.gaps))


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


def clip_lines(
    points: Float[np.ndarray, "K P 3"], direction: Float[np.ndarray, "K 3"], planes: Float[np.ndarray, "F 4"]
) -> tuple[Float[np.ndarray, "K P"], Float[np.ndarray, "K P"]]:
    """Where lines enter and leave the convex body n·x ≤ b.

    Args:
        points: P points of each of K bundles of parallel lines, metres.
        direction: one unit direction per bundle.
        planes: (n, b) of the body's facets.

    Returns:
        Distances from the points along the direction at which the lines enter and leave, metres; +∞ and −∞ where they
        miss the body.
    """
    enter, leave = np.empty(points.shape[:2]), np.empty(points.shape[:2])
    # A block of lines at a time, whose distances from all planes fit into the cache.
    step = max(1, CLIPPED // (points.shape[1] * len(planes)))
    for begin in range(0, len(points), step):
        block = slice(begin, begin + step)
        speed = (direction[block] @ planes[:, :3].T)[:, None]
        # A line along a plane, outside of it, leaves the body long before it could enter.
        speed = np.where(np.abs(speed) < 1e-9, 1e-12, speed)
        crossing = (planes[:, 3] - points[block] @ planes[:, :3].T) / speed
        enter[block] = np.where(speed < 0, crossing, -np.inf).max(axis=-1)
        leave[block] = np.where(speed > 0, crossing, np.inf).min(axis=-1)
    hit = enter < leave
    return np.where(hit, enter, np.inf), np.where(hit, leave, -np.inf)


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
    lines = _moved(lines, np.asarray(gripper.screws)[0], closed[index])
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


def gripper_corners(
    gripper: Gripper, poses: Float[np.ndarray, "K 7"], theta: Float[np.ndarray, " K"]
) -> list[Float[np.ndarray, "K G 3"]]:
    """Corners of the hulls of palm, finger 0 and finger 1, in the frame the gripper poses are given in, metres."""
    hand = reduce_gripper(gripper).hand
    palm, *fingers = (outer_corners(hand[k]) for k in range(3))
    local = [np.broadcast_to(palm, (len(theta), *palm.shape))]
    local += [_moved(points, screw, theta) for points, screw in zip(fingers, np.asarray(gripper.screws), strict=True)]
    turns = Rotation.from_quat(poses[:, :4], scalar_first=True).as_matrix().reshape(-1, 3, 3)
    return [part @ turns.swapaxes(1, 2) + poses[:, None, 4:] for part in local]


def _moved(
    points: Float[np.ndarray, "P 3"], screw: Float[np.ndarray, " 6"], theta: Float[np.ndarray, " K"]
) -> Float[np.ndarray, "K P 3"]:
    """Points of a finger at several finger coordinates, in the gripper frame."""
    motion = RigidTransform.from_exp_coords(theta[:, None] * np.concatenate([screw[3:], screw[:3]]))
    return points @ motion.rotation.as_matrix().swapaxes(1, 2) + motion.translation[:, None]


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
    moved = [_moved(front, screw, opened) for front, screw in zip(fingers, np.asarray(gripper.screws), strict=True)]
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


def hull_planes(vertices: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "F 4"]:
    """Planes (n, b) of the facets of a hull, n·x ≤ b inside; facets that lie in one plane give it once."""
    planes = qhull(vertices).equations * [1.0, 1.0, 1.0, -1.0]
    return planes[np.unique(planes.round(7), axis=0, return_index=True)[1]]
