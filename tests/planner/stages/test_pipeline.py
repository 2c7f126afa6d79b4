"""The pipeline as a library: another robot, no simulator."""

from dataclasses import replace

import jaxlie
import numpy as np
import pytest

from regrasp_planner import (
    Body,
    ConvexBody,
    Plan,
    PlanOptions,
    Reason,
    ReleaseArea,
    Scene,
    SegmentKind,
    StageKind,
    Task,
    plan,
)
from regrasp_planner.collision.clearance import configuration_clearance
from regrasp_planner.collision.model import collision_model
from regrasp_planner.ik.ik_solve import within_reach
from regrasp_planner.pose import rigid, wxyz_xyz
from regrasp_planner.robot.kinematics import forward_kinematics
from regrasp_planner.stages import search as stage_search
from regrasp_planner.stages.search import StageSearch

SIZE = np.array([0.04, 0.05, 0.12])


@pytest.fixture(scope="module")
def brick():
    return Body("brick", (ConvexBody.box(SIZE),), np.zeros(3), 0.3)


@pytest.fixture(scope="module")
def make_task(build, panda, brick):
    def make(goal, target=brick, start=None):
        # Below the base, so that the arm's lowest capsule is clear of it.
        table = build.box_obstacle("table", (1.0, 1.6, 0.04), (0.65, 0, -0.02))
        lying = build.pose((0.5, -0.25, SIZE[1] / 2), (np.pi / 2, 0, 0.3))
        return Task(
            target=target,
            pick=Scene("pick", lying, (table,)),
            place=Scene("place", np.asarray(goal, float), (table,)),
            release=ReleaseArea(np.array([0.5, 0.0, 0.0]), np.array([0.14, 0.12])),
            start=np.asarray(panda.home if start is None else start, float),
            supports=frozenset({"table"}),
        )

    return make


def flipped_goal(build):
    """Lying on the opposite side of where it lies: what was below is above."""
    return build.pose((0.5, 0.25, SIZE[1] / 2), (-np.pi / 2, 0, 0.3))


def check(found: Plan, task: Task, robot):
    """The plan as a claim: it is continuous, ends at the goal, moves the target as it says, and touches nothing."""
    q, target = task.start, task.pick.target_pose
    for stage in found.stages:
        np.testing.assert_allclose(stage.start_pose, target, atol=1e-9)
        for segment in stage.segments:
            if segment.trajectory is None:
                at = wxyz_xyz(rigid(np.asarray(forward_kinematics(robot.arm, q))[-1]) * rigid(stage.grasp.pose).inv())
                wanted = stage.start_pose if segment.kind is SegmentKind.CLOSE else stage.release_pose
                assert np.linalg.norm(at[4:] - wanted[4:]) < 2e-4
                assert (jaxlie.SO3(at[:4]).inverse() @ jaxlie.SO3(wanted[:4])).log() == pytest.approx(0, abs=2e-3)
                continue
            np.testing.assert_allclose(segment.trajectory.start, q, atol=1e-6)
            q = segment.trajectory.goal
            velocity, acceleration = segment.trajectory.peak_ratios(
                np.asarray(robot.arm.max_velocity), np.asarray(robot.arm.max_acceleration)
            )
            assert max(velocity, acceleration) <= 1.0
            if segment.kind in (SegmentKind.TRANSIT, SegmentKind.TRANSFER):
                held = segment.kind is SegmentKind.TRANSFER
                model = collision_model(
                    robot,
                    task.pick.obstacles,
                    held=task.target.pieces if held else (),
                    held_pose=wxyz_xyz(rigid(stage.grasp.pose).inv()),
                    margin_world=0.0,
                    margin_held=0.0,
                )
                samples = segment.trajectory.at(np.linspace(0, segment.trajectory.duration, 60))
                clearance = configuration_clearance(model, samples, segment.theta if not held else stage.grasp.theta)
                assert clearance.value.min() > -1e-4
        target = stage.settled_pose
    distance = np.linalg.norm(target[4:] - task.place.target_pose[4:])
    assert distance < 5e-3


def test_one_grasp_where_one_is_enough(panda, make_task, build):
    task = make_task(build.pose((0.5, 0.25, SIZE[1] / 2), (np.pi / 2, 0, 1.2)))
    found = plan(task, panda, "direct")
    assert found.success, found.failure
    assert [stage.kind for stage in found.stages] == [StageKind.PICK_TO_PLACE]
    assert found.stats.eval_grasp_calls > 0
    assert {"grasp_gen", "ik_solve", "path_plan", "total"} <= set(found.stats.seconds)
    check(found, task, panda)
    again = plan(task, panda, "direct")
    for one, other in zip(found.stages[0].segments, again.stages[0].segments, strict=True):
        if one.trajectory is not None:
            np.testing.assert_array_equal(one.trajectory.positions, other.trajectory.positions)


def test_a_regrasp_where_one_grasp_is_not_enough(panda, make_task, build):
    """Turned upside down, the side the gripper came from is on the table: no single grasp does it."""
    task = make_task(flipped_goal(build))
    direct = plan(task, panda, "direct")
    assert not direct.success
    assert direct.failure.reason in (Reason.NO_COMMON_GRASP, Reason.UNREACHABLE, Reason.NO_PATH)
    found = plan(task, panda, "static")
    assert found.success, found.failure
    assert [stage.kind for stage in found.stages] == [StageKind.PICK_TO_RELEASE, StageKind.REGRASP_TO_PLACE]
    first = found.stages[0].settled_pose
    # It rests on the table inside of the release area.
    corners = rigid(first).apply(task.target.hull_vertices())
    assert corners[:, 2].min() == pytest.approx(0.002, abs=3e-3)
    assert (np.abs(corners[:, :2] - task.release.center[:2]) <= task.release.half_extents + 1e-6).all()
    check(found, replace(task), panda)


def test_a_goal_out_of_reach_is_called_unreachable(panda, make_task, build):
    found = plan(make_task(build.pose((1.6, 0.25, SIZE[1] / 2), (np.pi / 2, 0, 0))), panda, "direct")
    assert found.failure.reason is Reason.UNREACHABLE
    assert "brick" in found.failure.message
    assert found.stages == ()


def test_a_target_wider_than_the_gripper_is_called_too_wide(panda, make_task, build):
    crate = Body("crate", (ConvexBody.box((0.1, 0.11, 0.12)),), np.zeros(3), 1.0)
    found = plan(make_task(build.pose((0.5, 0.25, 0.06)), target=crate), panda, "static")
    assert found.failure.reason is Reason.TOO_WIDE
    assert "'crate'" in found.failure.message
    assert "80 mm" in found.failure.message


def test_an_unknown_strategy_is_refused_with_the_known_ones(panda, make_task, build):
    with pytest.raises(ValueError, match=r"unknown strategy 'magic'.*direct, static, nonstatic, repeated, sampling"):
        plan(make_task(flipped_goal(build)), panda, "magic")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda task: replace(task, place=replace(task.place, target_pose=np.zeros(7))), "unit quaternion"),
        (lambda task: replace(task, place=replace(task.place, target_pose=np.full(7, np.nan))), "'place'"),
        (lambda task: replace(task, start=np.full(7, 9.0)), "'joint1'"),
        (lambda task: replace(task, start=np.zeros(3)), "shape"),
        (lambda task: replace(task, target=Body("ghost", (), np.zeros(3))), "'ghost'"),
    ],
)
def test_bad_tasks_are_failures_that_name_the_mistake(panda, make_task, build, spoil, message):
    found = plan(spoil(make_task(flipped_goal(build))), panda, "static")
    assert found.failure.reason is Reason.BAD_INPUT
    assert message in found.failure.message


def test_each_grasp_is_looked_at_once_in_each_place(make_task, panda, build, monkeypatch):
    stages = StageSearch(make_task(flipped_goal(build)), panda, 0, PlanOptions())
    pose = stages.task.pick.target_pose
    # From the middle of the table up to beyond the arm's reach, in the target's frame.
    placed = np.stack([build.pose((0.5, 0, 0.2 + 0.12 * k), (np.pi, 0, 0)) for k in range(12)])
    grippers = wxyz_xyz(rigid(pose).inv() * rigid(placed))
    asked = []

    def counted(model, targets, *rest):
        asked.append(len(targets))
        return within_reach(model, targets, *rest)

    monkeypatch.setattr(stage_search, "within_reach", counted)
    first = stages.looked(pose, grippers[:9])
    again = stages.looked(pose, grippers[3:])
    np.testing.assert_array_equal(first[3:], again[:6])
    assert asked == [9, 3]
    # Whether the arm hits something is another question.
    stages.looked(pose, grippers[:2], collisions=False)
    assert asked == [9, 3, 2]
    assert set(first.tolist()) == {0, 2}
