"""Reachability of gripper poses, graded from a few starts each: much cheaper than IkSolve."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from jaxtyping import Float, Int

from regrasp_planner.batching import bucket_size
from regrasp_planner.collision.clearance import configuration_clearance
from regrasp_planner.collision.model import CollisionModel
from regrasp_planner.ik.descent import descend_to_pose

TARGET_BUCKETS = (8, 32)
"""Targets in one batch."""
STARTS = 12
"""Starts of each target."""
CHECKED = 4
"""Solutions of each target whose clearance is measured."""
ITERATIONS = 24
TOLERANCE = 5e-3
"""Largest pose error of a solution, metres; generous, because IkSolve follows."""


class Reachability(IntEnum):
    """Grade of a gripper pose; see `grade_reachability`."""

    NONE = 0
    """No configuration within the joint limits was found."""
    BLOCKED = 1
    """There are configurations, but the arm collides in all that were checked."""
    FREE = 2
    """There is a configuration without collisions."""


def grade_reachability(
    model: CollisionModel, targets: Float[np.ndarray, "K 7"], seed: int = 0, collisions: bool = True
) -> Int[np.ndarray, " K"]:
    """Grade which gripper poses the arm can reach.

    Args:
        model: the bodies that may collide, usually without the gripper: the grasp search checks its collisions.
        targets: (K, 7) poses of the gripper frame in the world.
        seed: seed of the random starts.
        collisions: whether collisions count; if not, every pose within reach is free.

    Returns:
        (K,) `Reachability` of each pose.
    """
    robot, count = model.arrays.robot, len(targets)
    arm, home = robot.arm, np.asarray(robot.home, float)
    low, high = np.asarray(arm.lower, float), np.asarray(arm.upper, float)
    starts = np.random.default_rng(seed).uniform(low, high, (TARGET_BUCKETS[-1], STARTS, arm.dof))
    starts[:, 0] = home
    grades = np.full(count, int(Reachability.NONE))
    for begin in range(0, count, TARGET_BUCKETS[-1]):
        chosen = np.arange(begin, min(begin + TARGET_BUCKETS[-1], count))
        size = bucket_size(len(chosen), TARGET_BUCKETS)
        ends = descend_to_pose(arm, targets[np.resize(chosen, size)], starts[:size], CHECKED, ITERATIONS)
        q, solved = ends.q[: len(chosen)], (ends.pose_error() < TOLERANCE)[: len(chosen)]
        grades[chosen[solved.any(axis=1)]] = Reachability.BLOCKED if collisions else Reachability.FREE
        if not collisions:
            continue
        # The nearest to home first.
        order = np.where(solved, np.linalg.norm((q - home) / (high - low), axis=2), np.inf).argsort(axis=1)
        for rank in range(CHECKED):
            rows = np.flatnonzero((grades[chosen] == Reachability.BLOCKED) & (solved.sum(axis=1) > rank))
            if len(rows):
                clearance = configuration_clearance(model, q[rows, order[rows, rank]], 0.0, cap=0.0)
                grades[chosen[rows[clearance.value >= 0]]] = Reachability.FREE
    return grades
