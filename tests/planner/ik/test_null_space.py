"""The way out of collisions through the arm's null space."""

import numpy as np

from regrasp_planner.collision.clearance import configuration_clearance
from regrasp_planner.ik.candidates import TargetSearch, batches, descend, draw_starts, screen
from regrasp_planner.ik.null_space import leave_collisions

OPENING = 0.03


def test_null_space_descent_leaves_collisions(cluttered, gripper_poses, pose_errors):
    """From colliding configurations only, the augmented Lagrangian finds free ones for most of the poses."""
    model, tight = cluttered
    arm = model.arrays.robot.arm
    targets = gripper_poses(arm, tight[:32])
    home = np.asarray(model.arrays.robot.home)
    searches = [TargetSearch(model, target, OPENING, home, closest=tight[0]) for target in targets]
    for batch in batches(searches):
        starts = draw_starts(arm, batch, np.zeros((0, 7)), np.random.default_rng(0))
        screen(batch, descend(arm, batch, starts, 30), 4)
    trapped = [search for search in searches if search.colliding]
    for search in trapped:
        search.solutions.clear()
    assert len(trapped) >= 4
    for batch in batches(trapped):
        leave_collisions(batch, 4)
    escaped = [search for search in trapped if search.solutions]
    assert len(escaped) >= 0.5 * len(trapped)
    q = np.stack([search.solutions[0].q for search in escaped])
    position, rotation = pose_errors(arm, q, np.stack([search.target for search in escaped]))
    assert position.max() < 1e-4
    assert rotation.max() < 1e-3
    assert configuration_clearance(model, q, OPENING, cap=0.0, exact=True).value.min() >= 0.0
