"""Whether the gripper can grasp a hollow object that is too wide for it by a part, such as a mug's rim."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from regrasp_gym.objects.model import ObjectModel
from regrasp_gym.scenes.resting import RestingPose

FINGER = 0.02
"""Thickness of a finger and the gap around it, metres."""

GRIP = 0.01
"""Depth of a finger beside the part, metres."""


@lru_cache(maxsize=256)
def graspable_by_part(model: ObjectModel, pose: RestingPose, opening: float) -> bool:
    """Whether some piece of the lying object is thin enough, and free from above on both sides.

    Args:
        model: an object of several pieces.
        pose: its resting pose.
        opening: width of the widest part that fits the gripper, metres.
    """
    pieces = [piece @ pose.rotation.T for piece in model.pieces]
    hulls = [ConvexHull(piece) for piece in pieces]
    drop = np.arange(-0.02, GRIP + 1e-9, 0.005)
    for piece in pieces:
        axis, low, high = _thinnest(piece[:, :2])
        if high - low > opening:
            continue
        top = piece[piece[:, 2].argmax()]
        beside = 0.5 * (low + high) + np.array([-1, 1]) * (0.5 * (high - low) + 0.5 * FINGER)
        across = axis @ piece[:, :2].mean(axis=0)
        feet = piece[:, :2].mean(axis=0) + (beside - across)[:, None] * axis
        probes = np.array([[*foot, top[2] - depth] for foot in feet for depth in drop])
        if not any(_any_inside(hull, probes) for hull in hulls):
            return True
    return False


def _thinnest(points: Float[np.ndarray, "N 2"]) -> tuple[Float[np.ndarray, " 2"], float, float]:
    """Horizontal axis along which the points extend least, and their range along it."""
    normals = ConvexHull(points).equations[:, :2]
    extent = points @ normals.T
    k = int(np.ptp(extent, axis=0).argmin())
    return normals[k], float(extent[:, k].min()), float(extent[:, k].max())


def _any_inside(hull: ConvexHull, points: Float[np.ndarray, "N 3"]) -> bool:
    return bool((points @ hull.equations[:, :3].T + hull.equations[:, 3] < 0).all(axis=1).any())
