"""What stages share: each grasp is graded once in each place."""

import numpy as np

from regrasp_planner import PlanOptions
from regrasp_planner.ik.reachability import grade_reachability
from regrasp_planner.pose import rigid, wxyz_xyz
from regrasp_planner.stages import search as stage_search
from regrasp_planner.stages.search import StageSearch


def test_each_grasp_is_graded_once_in_each_place(flipped_task, panda, build, monkeypatch):
    stages = StageSearch(flipped_task, panda, 0, PlanOptions())
    pose = stages.task.pick.target_pose
    # From the middle of the table up to beyond the arm's reach, in the target's frame.
    placed = np.stack([build.pose((0.5, 0, 0.2 + 0.12 * k), (np.pi, 0, 0)) for k in range(12)])
    grippers = wxyz_xyz(rigid(pose).inv() * rigid(placed))
    asked = []

    def counted(model, targets, *rest):
        asked.append(len(targets))
        return grade_reachability(model, targets, *rest)

    monkeypatch.setattr(stage_search, "grade_reachability", counted)
    first = stages.quick_reachability(pose, grippers[:9])
    again = stages.quick_reachability(pose, grippers[3:])
    np.testing.assert_array_equal(first[3:], again[:6])
    assert asked == [9, 3]
    # Whether the arm hits something is another question.
    stages.quick_reachability(pose, grippers[:2], collisions=False)
    assert asked == [9, 3, 2]
    assert set(first.tolist()) == {0, 2}
