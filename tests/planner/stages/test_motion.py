"""The motion of a stage: motions are planned lazily, and an observer is told of every path query."""

import numpy as np
import pytest

from regrasp_planner import Failure, Grasp, Reason, SegmentKind, StageKind, Trajectory, plan
from regrasp_planner.stages.grasp_ik import GraspIk
from regrasp_planner.stages.motion import ApproachDepart, LazyMotions

KIND = StageKind.PICK_TO_PLACE
POSE = np.array([1.0, 0, 0, 0, 0, 0, 0])
BLOCKED = Failure(Reason.NO_PATH, KIND, "approach: table", "")
MISSING = Failure(Reason.UNREACHABLE, KIND, "", "")


@pytest.fixture
def ik():
    return GraspIk(Grasp(POSE, 0.01, 0.02, 1.9, 0.01), POSE, ())


def test_motions_are_planned_when_they_are_asked_for_and_once(ik):
    line = Trajectory(np.array([0.0, 1.0]), np.zeros((2, 7)), np.zeros((2, 7)))
    motion = ApproachDepart(line, line, 0.02)
    planned = []

    def attempts():
        for attempt in (BLOCKED, motion, motion):
            planned.append(attempt)
            yield attempt

    motions = LazyMotions(ik, attempts(), MISSING)
    assert planned == []
    assert motions.any_feasible()
    assert planned == [BLOCKED, motion]
    assert motions.failure is BLOCKED
    assert list(motions) == list(motions) == [motion, motion]
    assert len(planned) == 3


def test_without_a_motion_the_last_failure_says_why(ik):
    motions = LazyMotions(ik, iter([BLOCKED]), MISSING)
    assert not motions.any_feasible()
    assert motions.failure is BLOCKED
    assert LazyMotions(ik, iter(()), MISSING).failure is MISSING


def test_an_observer_is_told_of_every_path_of_the_plan(panda, make_task, build):
    class Recorder:
        def __init__(self):
            self.paths, self.lines = [], []

        def on_path(self, query, result):
            self.paths.append(result.trajectory)

        def on_line(self, query, result):
            self.lines.append(result.trajectory)

    recorder = Recorder()
    found = plan(make_task(build.lying_brick(0.5, 0.25, 1.2)), panda, "direct", observer=recorder)
    assert found.success, found.failure
    segments = {segment.kind: segment.trajectory for segment in found.stages[0].segments}
    assert any(segments[SegmentKind.TRANSIT] is path for path in recorder.paths)
    assert any(segments[SegmentKind.TRANSFER] is path for path in recorder.paths)
    assert any(segments[SegmentKind.LIFT] is line for line in recorder.lines)
