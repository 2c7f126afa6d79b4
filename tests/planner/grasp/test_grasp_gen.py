"""GraspGen against certified distances and problems whose answer is known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from regrasp_planner.grasp.grasp import GraspGenOptions, NoGraspReason, StartKind
from regrasp_planner.grasp.grasp_gen import PATIENCE, GraspSearch, generate_grasps
from regrasp_planner.placement.basins import ReleaseCone
from regrasp_planner.placement.tilted_release import plane_clearance
from regrasp_planner.robot.gripper import gripper_points

OPTIONS = GraspGenOptions()


@pytest.mark.parametrize("target", ["box", "can"], indirect=True)
def test_grasps_hold_the_target_between_opposite_faces(panda, build, free, target, hand, gap):
    """In free space: pads touch, on opposite sides, and nothing else of the gripper does."""
    result = generate_grasps(target, [free], panda.gripper)
    assert len(result.grasps) >= 4
    gripper, piece, origin = panda.gripper, target.pieces[0], build.pose()
    for grasp in result.grasps:
        assert grasp.quality >= OPTIONS.quality_threshold
        assert 0 <= grasp.theta <= grasp.opening <= 0.04
        fingers = hand.fingers(gripper, grasp.pose, grasp.theta)
        for k in np.asarray(gripper.contact):
            assert abs(gap(piece, origin, *fingers[int(k)])) < 2.5e-3
        assert min(gap(piece, origin, *part) for part in hand.palm(gripper, grasp.pose)) > 0
        opened = hand.fingers(gripper, grasp.pose, grasp.opening)
        assert min(gap(piece, origin, *part) for part in opened) > 1e-3
        # The line between the contacts is the closing axis, and normal to the surface there.
        closing = Rotation.from_quat(grasp.pose[:4], scalar_first=True).apply(np.asarray(gripper.width_axis))
        width = np.ptp(target.hull_vertices() @ closing)
        assert width < 2 * grasp.theta + 2e-3


def test_grasps_of_a_union_hold_in_each_scene(panda, bodies, scenes, hand, gap):
    body = bodies.box()
    result = generate_grasps(body, scenes, panda.gripper)
    assert len(result.grasps) >= 3
    margin = OPTIONS.margin * 0.08
    for grasp in result.grasps:
        for scene in scenes:
            pose = grasp.gripper_pose(scene.target_pose)
            parts = [*hand.palm(panda.gripper, pose), *hand.fingers(panda.gripper, pose, grasp.opening)]
            for obstacle in scene.obstacles:
                for part in parts:
                    distance = gap(obstacle.body.pieces[0], obstacle.pose, *part)
                    assert distance > margin - 3e-4, (scene.name, obstacle.body.name)


def test_too_wide_and_enclosed_targets_are_told_apart(panda, bodies, free, caged):
    wide = generate_grasps(bodies.box((0.09, 0.1, 0.12)), [free], panda.gripper)
    assert (wide.grasps, wide.reason, wide.evaluations) == ((), NoGraspReason.TOO_WIDE, 0)
    enclosed = generate_grasps(bodies.box((0.05, 0.05, 0.1)), [caged], panda.gripper)
    assert (enclosed.grasps, enclosed.reason) == ((), NoGraspReason.ENCLOSED)
    assert enclosed.evaluations > 0


def test_searching_again_over_other_ground_evaluates_only_what_is_new(panda, bodies, scenes):
    search = GraspSearch(bodies.box(), scenes[:1], panda.gripper)
    first = [found for batch in search.grasps() for found in batch]
    spent = search.evaluations
    assert first
    # All of the first grasps were refused, so more were looked at than the first ones.
    assert 0 < spent <= PATIENCE * OPTIONS.screened + OPTIONS.refined * OPTIONS.max_evaluations
    assert spent <= OPTIONS.budget
    again = next(search.grasps())
    assert search.evaluations == spent
    known = {found.grasp.pose.tobytes() for found in first}
    assert all(found.grasp.pose.tobytes() in known for found in again)


@pytest.mark.parametrize("down", np.concatenate([np.eye(3), -np.eye(3)]).tolist())
def test_grasps_clear_the_ground_they_are_asked_for(panda, bodies, down):
    """In every pose of a box in which it can be taken, statically and with a tilt within the cone."""
    body, down = bodies.box(), np.array(down)
    search, margin = GraspSearch(body, (), panda.gripper), OPTIONS.margin * 0.08
    upright = [found for batch in search.grasps(end=ReleaseCone(down, 0.0)) for found in batch]
    tilted = [found for batch in search.grasps(end=ReleaseCone(down, 0.3)) for found in batch]
    assert len(tilted) >= len(upright)
    # Closing from above and below, one finger would be under the box as it settles.
    assert bool(tilted) == (abs(down[0]) < 1)
    for found in [*upright, *tilted]:
        opening = np.array([found.grasp.opening])
        corners = np.concatenate(gripper_points(panda.gripper, found.grasp.pose[None], opening), axis=1)
        assert plane_clearance(body.hull_vertices(), corners, found.release[None])[0] > margin - 1e-6
        assert np.arccos(np.clip(found.release @ down, -1, 1)) < 0.3 + 1e-6
    assert all(found.release @ down > 1 - 1e-12 for found in upright)


def test_plain_multi_start_finds_grasps_too_but_for_more_evaluations(panda, bodies, scenes):
    critical = generate_grasps(bodies.box(), scenes, panda.gripper, GraspGenOptions(enough=1))
    options = GraspGenOptions(starts=StartKind.UNIFORM, refined=24, max_evaluations=24, budget=2000, enough=1)
    uniform = generate_grasps(bodies.box(), scenes, panda.gripper, options)
    assert critical.grasps
    assert uniform.evaluations > critical.evaluations
    for grasp in uniform.grasps:
        assert grasp.quality >= options.quality_threshold


def test_same_problem_same_grasps(panda, bodies, scenes):
    first, second = (generate_grasps(bodies.box(), scenes, panda.gripper) for _ in range(2))
    assert first.evaluations == second.evaluations
    for a, b in zip(first.grasps, second.grasps, strict=True):
        np.testing.assert_array_equal(a.pose, b.pose)
