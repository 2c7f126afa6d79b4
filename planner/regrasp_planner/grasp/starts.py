"""Initial grasps of GraspGen, worked out in closed form on the target alone.

The closing axis is a critical direction of the width function. Lines along the axis and along the approach tell where
the pads touch and how far the gripper can be pushed over the target. So the fingers of an initial grasp touch on
opposite sides, and only the obstacles are left to check.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from regrasp_planner.geometry.hull import clip_lines, hull_planes
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.grasp.closing_axes import closing_axes
from regrasp_planner.grasp.grasp import GraspGenOptions, StartKind
from regrasp_planner.grasp.open_gripper import OpenGripper
from regrasp_planner.grasp.problem import graspable_parts
from regrasp_planner.robot.gripper import enclosing_points, finger_coordinate, finger_points, reduce_gripper
from regrasp_planner.robot.model import Gripper
from regrasp_planner.task import Body


class InitialGrasps(NamedTuple):
    """Initial grasps.

    Attributes:
        poses: (K, 7) gripper poses in the target's frame.
        thetas: (K,) finger coordinates at which the pads touch.
        depths: (K,) depth of the grasp centre below the faces of its part that the fingers do not press on, metres.
        parts: (K,) index of the part of the target between the pads, see `graspable_parts`.
    """

    poses: Float[np.ndarray, "K 7"]
    thetas: Float[np.ndarray, " K"]
    depths: Float[np.ndarray, " K"]
    parts: Int[np.ndarray, " K"]

    @staticmethod
    def none() -> InitialGrasps:
        """No grasps."""
        return InitialGrasps(np.zeros((0, 7)), np.zeros(0), np.zeros(0), np.zeros(0, int))

    @staticmethod
    def concatenate(several: Sequence[InitialGrasps]) -> InitialGrasps:
        """All grasps of several sets."""
        return InitialGrasps(*(np.concatenate(leaves) for leaves in zip(*several, strict=True)))

    def at(self, indices: Int[np.ndarray, " B"]) -> InitialGrasps:
        """The grasps with the given indices."""
        return InitialGrasps(*(leaf[indices] for leaf in self))


def initial_grasps(target: Body, hand: OpenGripper, options: GraspGenOptions, seed: int) -> InitialGrasps:
    """Initial grasps of the kind that the options ask for; none if the target is too wide for the gripper.

    Args:
        target: the body to grasp.
        hand: the gripper.
        options: see `GraspGenOptions`.
        seed: seed of the uniform starts.
    """
    parts = graspable_parts(target)
    widest = hand.length * (1 - 0.25 * options.margin)
    share = options.max_axes if len(parts) == 1 else max(2, options.max_axes // len(parts))
    axes = [closing_axes(part, widest, share, options.lean)[0] for part in parts]
    number = sum(map(len, axes))
    if number == 0:
        return InitialGrasps.none()
    if options.starts is StartKind.UNIFORM:
        return uniform_starts(target.hull_vertices(), hand.gripper, options.refined, seed)
    angles = 2 * options.angles if number <= 4 else options.angles
    starts = [
        grasp_starts(parts, k, axes[k], hand.gripper, angles, 1.2 * hand.margin)
        for k in range(len(parts))
        if len(axes[k])
    ]
    return InitialGrasps.concatenate(starts)


def grasp_starts(
    parts: Sequence[Float[np.ndarray, "N 3"]],
    part: int,
    axes: Float[np.ndarray, "m 3"],
    gripper: Gripper,
    angles: int,
    margin: float,
) -> InitialGrasps:
    """Initial grasps of one part of the target: closing axes, approach angles about each, offsets across and along.

    The gripper is pushed over the part until the grasp centre is level with its middle, or until palm or fingertips
    touch; and once more only until the pads hold on. Long parts are also grasped off their middle.

    Args:
        parts: vertices of the target's graspable parts, metres, see `graspable_parts`.
        part: index of the part between the pads.
        axes: (m, 3) closing axes.
        gripper: the gripper.
        angles: approach angles about each axis.
        margin: clearance of palm and fingertips from the target, metres.

    Returns:
        Those whose pads meet the part and can be as far apart as it is wide.
    """
    reduced = reduce_gripper(gripper)
    frames, origins = _approaches(parts[part], axes, angles, 0.5 * float(gripper.max_opening))
    width_axis = np.asarray(gripper.width_axis)
    tool = np.stack([width_axis, np.asarray(gripper.approach_axis)], axis=1)
    turns = frames @ np.column_stack([tool, np.cross(tool[:, 0], tool[:, 1])]).T
    closing, approach = frames[:, :, 0], frames[:, :, 1]

    local = parts[part] @ frames
    low, high = local.min(axis=1), local.max(axis=1)
    closed = finger_coordinate(gripper, (high - low)[:, 0])
    opened = np.minimum(closed + margin * reduced.travel, float(gripper.upper))
    # How far the gripper moves forward until the palm or an opened fingertip meets the target.
    pieces = parts if len(parts) == 1 else parts[:-1]
    probes = origins[:, None] + _fronts(gripper, opened) @ turns.swapaxes(1, 2)
    travel = np.min([clip_lines(probes, approach, hull_planes(each))[0].min(axis=1) for each in pieces], axis=0)
    travel = np.minimum(travel, _under_palm(np.concatenate(pieces), origins, turns, gripper))
    deep = np.minimum(0.0, travel - margin)
    shallow = low[:, 1] - (origins * approach).sum(axis=1) + 0.6 * reduced.tip_length
    room = np.flatnonzero(shallow < deep - 0.1 * float(gripper.max_opening))
    index = np.concatenate([np.arange(len(deep)), room, room])
    forward = np.concatenate([deep, shallow[room], 0.5 * (deep + shallow)[room]])
    origins = origins[index] + forward[:, None] * approach[index]

    # The pads touch the outermost points of the part between them. A round pad is set back away from its middle.
    planes = hull_planes(parts[part])
    lines, recess = _pad_lines(reduced.pads[0], width_axis)
    lines = finger_points(lines, np.asarray(gripper.screws)[0], closed[index])
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
    return InitialGrasps(poses, finger_coordinate(gripper, last - first), depths, np.full(len(index), part))


def uniform_starts(hull: Float[np.ndarray, "N 3"], gripper: Gripper, count: int, seed: int) -> InitialGrasps:
    """Plain multi-start: random orientations, half-open fingers, the palm just off the middle of the target.

    Args:
        hull: (N, 3) the target's vertices.
        gripper: the gripper.
        count: number of starts.
        seed: seed of the orientations.
    """
    turns = Rotation.random(count, rng=np.random.default_rng(seed))
    approach = turns.apply(np.asarray(gripper.approach_axis))
    middle = 0.5 * (hull.min(axis=0) + hull.max(axis=0))
    nearest = (hull @ approach.T).min(axis=0) - approach @ middle
    back = np.minimum(0.0, nearest + reduce_gripper(gripper).finger_length)
    poses = np.concatenate([turns.as_quat(scalar_first=True), middle + back[:, None] * approach], axis=1)
    half = 0.5 * (float(gripper.lower) + float(gripper.upper))
    return InitialGrasps(poses, np.full(count, half), np.zeros(count), np.zeros(count, int))


def _approaches(
    part: Float[np.ndarray, "N 3"], axes: Float[np.ndarray, "m 3"], angles: int, long: float
) -> tuple[Float[np.ndarray, "K 3 3"], Float[np.ndarray, "K 3"]]:
    """Frames (closing, approach, across), and points level with the middle of the part, on it and beside it."""
    turns = np.arange(angles) * (2 * np.pi / angles)
    frames: list[np.ndarray] = []
    origins: list[np.ndarray] = []
    for axis in axes:
        other = np.eye(3)[np.argmin(np.abs(axis))]
        first = np.cross(axis, other) / np.linalg.norm(np.cross(axis, other))
        approach = np.outer(np.cos(turns), first) + np.outer(np.sin(turns), np.cross(axis, first))
        frame = np.stack([np.broadcast_to(axis, approach.shape), approach, np.cross(axis, approach)], axis=2)
        local = part @ frame
        low, high = local.min(axis=1), local.max(axis=1)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        # Off the middle, but with the pads still on the part, at least if it is longer than the gripper.
        off = np.where(half[:, 2] > long, 0.7, 0.6) * half[:, 2]
        for offset in (0.0 * off, 0.5 * off, -0.5 * off, off, -off):
            frames.append(frame)
            origins.append(np.einsum("kij,kj->ki", frame, middle + offset[:, None] * [0.0, 0.0, 1.0]))
    return np.concatenate(frames), np.concatenate(origins)


def _fronts(gripper: Gripper, opened: Float[np.ndarray, " K"]) -> Float[np.ndarray, "K P 3"]:
    """Points on the fronts of the palm and of both fingers, opened to each θ, in the gripper frame."""
    axis, hand = np.asarray(gripper.approach_axis), reduce_gripper(gripper).hand
    palm, *fingers = (_face(enclosing_points(hand[k]), axis) for k in range(3))
    moved = [
        finger_points(front, screw, opened) for front, screw in zip(fingers, np.asarray(gripper.screws), strict=True)
    ]
    return np.concatenate([np.broadcast_to(palm, (len(opened), *palm.shape)), *moved], axis=1)


def _under_palm(
    corners: Float[np.ndarray, "N 3"],
    origins: Float[np.ndarray, "K 3"],
    turns: Float[np.ndarray, "K 3 3"],
    gripper: Gripper,
) -> Float[np.ndarray, " K"]:
    """How far the gripper moves forward until the palm meets the first of the target's corners in front of it."""
    axis, reduced = np.asarray(gripper.approach_axis), reduce_gripper(gripper)
    palm = enclosing_points(reduced.hand[0])
    local = (corners - origins[:, None]) @ turns
    level = 1.0 - np.abs(axis)
    inside = ((local >= palm.min(axis=0)) & (local <= palm.max(axis=0)) | (level < 0.5)).all(axis=2)
    return np.where(inside, local @ axis + reduced.finger_length, np.inf).min(axis=1)


def _face(vertices: Float[np.ndarray, "N 3"], normal: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "9 3"]:
    """A grid of 3 × 3 points level with the outermost point along ``normal``, spread over the width across it."""
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
    """Points spread over a pad's face, and how far its surface there lies behind its foremost point, metres."""
    vertices, radius = pad.hull_vertices(), float(pad.radius)
    if radius == 0:
        return _face(vertices, normal), np.zeros(9)
    other = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(normal, other) / np.linalg.norm(np.cross(normal, other))
    lateral = np.stack([first, np.cross(normal, first)])
    low, high = (vertices @ lateral.T).min(axis=0), (vertices @ lateral.T).max(axis=0)
    # Points of the core at most half a radius apart; about each, the part of the sweep that a side slanted by up to
    # 30° touches.
    cores = [np.linspace(a, b, 1 + round(2 * (b - a) / radius)) for a, b in zip(low, high, strict=True)]
    core = np.stack(np.meshgrid(*cores, indexing="ij"), axis=-1).reshape(-1, 2)
    offsets = radius * np.array([[0, 0], [-0.5, 0], [-0.25, 0], [0.25, 0], [0.5, 0], [0, -0.5], [0, 0.5]])
    points = (core[:, None] + offsets).reshape(-1, 2)
    recess = radius - np.sqrt(radius**2 - (offsets**2).sum(axis=1))
    front = (vertices @ normal).max()
    return points @ lateral + front * normal, np.tile(recess, len(core))
