"""Grades of gripper poses."""

import numpy as np

from regrasp_planner.collision.model import collision_model
from regrasp_planner.ik.reachability import Reachability, grade_reachability


def test_grades_tell_free_blocked_and_unreachable_poses_apart(panda, build):
    down = (np.pi, 0, 0)
    targets = np.stack([build.pose(xyz, down) for xyz in ((0.45, 0, 0.3), (0.45, 0, -0.1), (1.5, 0, 0.4))])
    table = (build.box_obstacle("table", (1.2, 1.6, 0.04), (0.4, 0, -0.03)),)
    model = collision_model(panda, table, overrides={("link1", "table"): None})
    grades = [Reachability.FREE, Reachability.BLOCKED, Reachability.NONE]
    assert grade_reachability(model, targets).tolist() == grades
    assert grade_reachability(model, targets, collisions=False).tolist() == [Reachability.FREE] * 2 + grades[2:]
