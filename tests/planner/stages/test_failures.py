"""Why there is no plan: the failure that says most, and its constraint."""

import numpy as np

from regrasp_planner import Body, Failure, Grasp, Reason, StageKind
from regrasp_planner.stages.failures import most_advanced_failure, unreachable
from regrasp_planner.stages.grasp_ik import GraspIk

KIND = StageKind.PICK_TO_PLACE


def test_the_later_failure_in_the_pipeline_wins_and_the_first_of_two_alike():
    enclosed, path, other_path = (
        Failure(reason, KIND, constraint, "")
        for reason, constraint in ((Reason.ENCLOSED, ""), (Reason.NO_PATH, "one"), (Reason.NO_PATH, "other"))
    )
    assert most_advanced_failure(None, enclosed) is enclosed
    assert most_advanced_failure(path, enclosed) is path
    assert most_advanced_failure(enclosed, path) is path
    assert most_advanced_failure(path, other_path) is path


def test_out_of_reach_names_the_constraint_that_most_grasps_fail_by():
    pose = np.array([1.0, 0, 0, 0, 0, 0, 0])
    grasp = Grasp(pose, 0.01, 0.02, 1.9, 0.01)
    constraints = ("joint limits: joint4, 0.1 rad", "world collision: link5", "joint limits: joint4, 0.2 rad")
    failure = unreachable(Body("mug", (), np.zeros(3)), KIND, [GraspIk(grasp, pose, (), each) for each in constraints])
    assert failure.reason is Reason.UNREACHABLE
    assert failure.constraint == "joint limits: joint4"
    assert "'mug'" in failure.message
