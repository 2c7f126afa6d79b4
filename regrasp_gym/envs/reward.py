"""Goals, success and rewards, for single goals and for batches.

A goal is an array of `GOAL_SIZE` entries: the target's pose (wxyz_xyz), whether it moves (0 or 1), whether the gripper
touches it (0 or 1), and the gripper's distance from it in metres. The last entry only shapes the dense reward.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from regrasp_gym.simulation.scenario import Tolerance

GOAL_SIZE = 10

_MOVING, _TOUCHED, _DISTANCE = 7, 8, 9


def pose_errors(
    a: Float[np.ndarray, "*batch n"], b: Float[np.ndarray, "*batch n"]
) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch"]]:
    """Distance (metres) and angle (radians, 0 … π) between poses whose first 7 entries are wxyz_xyz."""
    distance = np.linalg.norm(a[..., 4:7] - b[..., 4:7], axis=-1)
    qa, qb = a[..., :4], b[..., :4]
    # atan2 of chord lengths: the arccos of the dot product loses half of the digits at small angles.
    near, far = np.linalg.norm(qa - qb, axis=-1), np.linalg.norm(qa + qb, axis=-1)
    angle = 4 * np.arctan2(np.minimum(near, far), np.maximum(near, far))
    return distance, angle


def is_success(
    achieved: Float[np.ndarray, "*batch 10"], desired: Float[np.ndarray, "*batch 10"], tolerance: Tolerance
) -> Bool[np.ndarray, "*batch"]:
    """Whether the target is within tolerance of the goal pose, and its two flags do not exceed the goal's.

    The environment's own goals ask for a target at rest that the gripper does not touch.
    """
    flags = slice(_MOVING, _TOUCHED + 1)
    calm = (achieved[..., flags] <= desired[..., flags]).all(axis=-1)
    return _in_place(achieved, desired, tolerance) & calm


def sparse_reward(
    achieved: Float[np.ndarray, "*batch 10"], desired: Float[np.ndarray, "*batch 10"], tolerance: Tolerance
) -> Float[np.ndarray, "*batch"]:
    """0 on success, else −1."""
    return is_success(achieved, desired, tolerance).astype(float) - 1.0


def dense_reward(
    achieved: Float[np.ndarray, "*batch 10"], desired: Float[np.ndarray, "*batch 10"], tolerance: Tolerance
) -> Float[np.ndarray, "*batch"]:
    """0 on success, else −1 + 0.25 reach + 0.7 closeness, in [−1, −0.05].

    closeness = 1 − tanh((distance + lever · angle) / length) of the target from its goal;
    reach = 1 − tanh(distance / length) of the gripper from the target, and 1 once the target is in place, so that
    letting go costs nothing.
    """
    distance, angle = pose_errors(achieved, desired)
    closeness = 1 - np.tanh((distance + tolerance.lever * angle) / tolerance.length)
    near = 1 - np.tanh(achieved[..., _DISTANCE] / tolerance.length)
    reach = np.where(_in_place(achieved, desired, tolerance), 1.0, near)
    return np.where(is_success(achieved, desired, tolerance), 0.0, -1 + 0.25 * reach + 0.7 * closeness)


def _in_place(achieved: np.ndarray, desired: np.ndarray, tolerance: Tolerance) -> np.ndarray:
    distance, angle = pose_errors(achieved, desired)
    return (distance <= tolerance.position) & (angle <= tolerance.rotation)


REWARDS = {"sparse": sparse_reward, "dense": dense_reward}
"""Reward functions (achieved, desired, tolerance) by ``reward_type``."""
