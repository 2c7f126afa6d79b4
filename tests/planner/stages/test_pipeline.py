"""The pipeline as a library: another robot, no simulator."""

from dataclasses import replace

import jaxlie
import numpy as np
import pytest

from regrasp_planner import (
    Body,
    ConvexBody,
    Plan,
    Reason,
    SegmentKind,
    StageKind,
    Task,
    plan,
)
from regrasp_planner.collision.clearance import configuration_clearance
from regrasp_planner.collision.model import collision_model
from regrasp_planner.pose import rigid, wxyz_xyz
from regrasp_planner.robot.kinematics import forward_kinematics


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
    task = make_task(build.lying_brick(0.5, 0.25, 1.2))
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


def test_a_regrasp_where_one_grasp_is_not_enough(panda, flipped_task):
    """Turned upside down, the side the gripper came from is on the table: no single grasp does it."""
    task = flipped_task
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
    found = plan(make_task(build.lying_brick(1.6, 0.25, 0)), panda, "direct")
    assert found.failure.reason is Reason.UNREACHABLE
    assert "brick" in found.failure.message
    assert found.stages == ()


def test_a_target_wider_than_the_gripper_is_called_too_wide(panda, make_task, build):
    crate = Body("crate", (ConvexBody.box((0.1, 0.11, 0.12)),), np.zeros(3), 1.0)
    found = plan(make_task(build.pose((0.5, 0.25, 0.06)), target=crate), panda, "static")
    assert found.failure.reason is Reason.TOO_WIDE
    assert "'crate'" in found.failure.message
    assert "80 mm" in found.failure.message


def test_an_unknown_strategy_is_refused_with_the_known_ones(panda, flipped_task):
    with pytest.raises(ValueError, match=r"unknown strategy 'magic'.*direct, static, nonstatic, repeated, sampling"):
        plan(flipped_task, panda, "magic")


def test_a_mistake_in_the_task_is_bad_input(panda, flipped_task):
    found = plan(replace(flipped_task, start=np.full(7, 9.0)), panda, "static")
    assert found.failure.reason is Reason.BAD_INPUT
    assert "'joint1'" in found.failure.message
    assert found.stages == ()
