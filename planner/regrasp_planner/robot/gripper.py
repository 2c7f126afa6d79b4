"""The gripper reduced to three hulls and two pads, and the gap between its pads in metres."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import RigidTransform, Rotation

from regrasp_planner.geometry.support import ConvexBody, support_value
from regrasp_planner.memo import IdentityMemo
from regrasp_planner.robot.model import Gripper


def _enclosing_hull(bodies: ConvexBody, indices: Int[np.ndarray, " K"]) -> ConvexBody:
    """One body of at most 16 vertices that contains several."""
    radius = float(np.min([bodies[int(i)].radius for i in indices]))
    points = []
    for i in indices:
        body = bodies[int(i)]
        # The smallest radius remains a sweep; the rest of a larger one becomes a cube about each vertex.
        points.append(_with_cubes(body.hull_vertices(), float(body.radius) - radius))
    return ConvexBody.from_vertices(np.concatenate(points), radius=radius, max_vertices=16)


def enclosing_points(body: ConvexBody) -> Float[np.ndarray, "N 3"]:
    """Points (N, 3), metres, whose hull contains the body with its sweep."""
    return _with_cubes(body.hull_vertices(), float(body.radius))


def _with_cubes(points: Float[np.ndarray, "N 3"], half: float) -> Float[np.ndarray, "M 3"]:
    """The corners of a cube with this half size about each point; the points themselves if it is 0."""
    if half <= 0:
        return points
    cube = np.array(np.meshgrid(*[[-half, half]] * 3)).reshape(3, -1).T
    return (points[:, None] + cube).reshape(-1, 3)


class ReducedGripper(NamedTuple):
    """A gripper with one hull for the palm and one for each finger, and its measures.

    Attributes:
        hand: convex hulls of the palm and of each finger at θ = 0, stacked, in the gripper frame.
        pads: the two contact bodies at θ = 0, stacked, in the gripper frame.
        finger_length: distance from the palm to the gripper frame's origin along the approach axis, metres.
        tip_length: distance from that origin to the fingertips along the approach axis, metres.
        thetas, gaps: (16,) finger coordinates over their range, and the gaps between the pads there, metres.
        travel: change of θ per metre that each finger moves outwards, averaged over its range; 1 for sliding fingers,
            whose θ is their travel.
    """

    hand: ConvexBody
    pads: ConvexBody
    finger_length: float
    tip_length: float
    thetas: Float[np.ndarray, " 16"]
    gaps: Float[np.ndarray, " 16"]
    travel: float


_REDUCED = IdentityMemo()


def reduce_gripper(gripper: Gripper) -> ReducedGripper:
    """Convex hulls of the palm and of each finger, and the two pads; computed once per gripper."""
    return _REDUCED.get(gripper, lambda: _reduced(gripper))


def _reduced(gripper: Gripper) -> ReducedGripper:
    owner = np.asarray(gripper.finger_of)
    hulls = [_enclosing_hull(gripper.palm, np.arange(gripper.palm.batch_size))]
    hulls += [_enclosing_hull(gripper.fingers, np.flatnonzero(owner == k)) for k in (0, 1)]
    pads = [gripper.fingers[int(i)] for i in np.asarray(gripper.contact)]
    approach = np.asarray(gripper.approach_axis)
    palm_front = float(support_value(hulls[0], jnp.asarray(approach)))
    tip = max(float(support_value(hull, jnp.asarray(approach))) for hull in hulls[1:])
    thetas = np.linspace(float(gripper.lower), float(gripper.upper), 16)
    gaps = _pad_gaps(gripper, pads, thetas)
    travel = round(float(2 * (thetas[-1] - thetas[0]) / (gaps[-1] - gaps[0])), 9)
    return ReducedGripper(ConvexBody.stack(hulls), ConvexBody.stack(pads), -palm_front, tip, thetas, gaps, travel)


def _pad_gaps(gripper: Gripper, pads: Sequence[ConvexBody], thetas: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    """Gaps (T,) between the pads along the width axis, metres."""
    axis = np.asarray(gripper.width_axis)
    along = [
        finger_points(pad.hull_vertices(), screw, thetas) @ axis
        for pad, screw in zip(pads, np.asarray(gripper.screws), strict=True)
    ]
    if along[0].mean() > along[1].mean():
        along.reverse()
    swept = sum(float(pad.radius) for pad in pads)
    return along[1].min(axis=1) - along[0].max(axis=1) - swept


def finger_coordinate(gripper: Gripper, width: Float[np.ndarray, "*K"] | float) -> Float[np.ndarray, "*K"]:
    """θ at which the gap between the pads is ``width`` metres; the nearer limit of θ if no θ gives that gap."""
    reduced = reduce_gripper(gripper)
    return np.asarray(np.interp(width, reduced.gaps, reduced.thetas))


def pad_gap(gripper: Gripper, theta: float) -> float:
    """Gap between the pads at finger coordinate θ, metres."""
    reduced = reduce_gripper(gripper)
    return float(np.interp(theta, reduced.thetas, reduced.gaps))


def gripper_points(
    gripper: Gripper, poses: Float[np.ndarray, "K 7"], theta: Float[np.ndarray, " K"]
) -> list[Float[np.ndarray, "K G 3"]]:
    """Points whose hulls contain the palm, finger 0 and finger 1, for each of K grasps.

    Args:
        gripper: the gripper.
        poses: (K, 7) poses of the gripper frame, metres.
        theta: (K,) finger coordinates.

    Returns:
        Three arrays (K, G, 3), metres, in the frame of the poses.
    """
    hand = reduce_gripper(gripper).hand
    palm, *fingers = (enclosing_points(hand[k]) for k in range(3))
    local = [np.broadcast_to(palm, (len(theta), *palm.shape))]
    local += [
        finger_points(points, screw, theta) for points, screw in zip(fingers, np.asarray(gripper.screws), strict=True)
    ]
    turns = Rotation.from_quat(poses[:, :4], scalar_first=True).as_matrix().reshape(-1, 3, 3)
    return [part @ turns.swapaxes(1, 2) + poses[:, None, 4:] for part in local]


def finger_points(
    points: Float[np.ndarray, "P 3"], screw: Float[np.ndarray, " 6"], theta: Float[np.ndarray, " K"]
) -> Float[np.ndarray, "K P 3"]:
    """Points (K, P, 3) of a finger at K finger coordinates, in the gripper frame, metres.

    Args:
        points: (P, 3) at θ = 0.
        screw: (6,) twist (v, ω) of the finger, of ``Gripper.screws``.
        theta: (K,) finger coordinates.
    """
    motion = RigidTransform.from_exp_coords(theta[:, None] * np.concatenate([screw[3:], screw[:3]]))
    return points @ motion.rotation.as_matrix().swapaxes(1, 2) + motion.translation[:, None]
