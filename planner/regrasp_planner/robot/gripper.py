"""The gripper reduced to three hulls and two pads, and what its finger coordinate means in metres."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import RigidTransform, Rotation

from regrasp_planner.geometry.support import ConvexBody, support_value
from regrasp_planner.memo import IdentityMemo
from regrasp_planner.robot.model import Gripper


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


_REDUCED = IdentityMemo()


def reduce_gripper(gripper: Gripper) -> GripperBodies:
    """Convex hulls of the palm and of each finger, and the two pads; computed once per gripper."""
    return _REDUCED.get(gripper, lambda: _reduced(gripper))


def _reduced(gripper: Gripper) -> GripperBodies:
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
    return GripperBodies(ConvexBody.stack(hulls), ConvexBody.stack(pads), -palm_front, tip, thetas, gaps, travel)


def _pad_gaps(gripper: Gripper, pads: Sequence[ConvexBody], thetas: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    """Distance of the pads along the width axis at finger coordinates, metres."""
    axis = np.asarray(gripper.width_axis)
    along = [
        moved_points(pad.hull_vertices(), screw, thetas) @ axis
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


def gripper_corners(
    gripper: Gripper, poses: Float[np.ndarray, "K 7"], theta: Float[np.ndarray, " K"]
) -> list[Float[np.ndarray, "K G 3"]]:
    """Corners of the hulls of palm, finger 0 and finger 1, in the frame the gripper poses are given in, metres."""
    hand = reduce_gripper(gripper).hand
    palm, *fingers = (outer_corners(hand[k]) for k in range(3))
    local = [np.broadcast_to(palm, (len(theta), *palm.shape))]
    local += [
        moved_points(points, screw, theta) for points, screw in zip(fingers, np.asarray(gripper.screws), strict=True)
    ]
    turns = Rotation.from_quat(poses[:, :4], scalar_first=True).as_matrix().reshape(-1, 3, 3)
    return [part @ turns.swapaxes(1, 2) + poses[:, None, 4:] for part in local]


def moved_points(
    points: Float[np.ndarray, "P 3"], screw: Float[np.ndarray, " 6"], theta: Float[np.ndarray, " K"]
) -> Float[np.ndarray, "K P 3"]:
    """Points of a finger at several finger coordinates, in the gripper frame."""
    motion = RigidTransform.from_exp_coords(theta[:, None] * np.concatenate([screw[3:], screw[:3]]))
    return points @ motion.rotation.as_matrix().swapaxes(1, 2) + motion.translation[:, None]
