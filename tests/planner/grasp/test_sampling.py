"""The sampling baseline: every grasp it gives against coal, its bounds against what they bound, and known answers."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from regrasp_planner.grasp.grasp import NoGraspReason
from regrasp_planner.grasp.sampling import (
    ALIKE_ANGLE,
    ALIKE_SHIFT,
    FINGER_GAP,
    SamplingOptions,
    _Sampler,
    sample_grasps,
)
from regrasp_planner.pose import rigid, wxyz_xyz
from regrasp_planner.robot.gripper import reduce_gripper

OPTIONS = SamplingOptions(count=20_000)
MARGIN = OPTIONS.margin * 0.08
ORIGIN = np.array([1.0, 0, 0, 0, 0, 0, 0])


def check(grasp, target, scenes, gripper, hand, oracle, options=OPTIONS):
    """That a grasp keeps every rule, by coal and by plain geometry."""
    origin, axis = ORIGIN, np.asarray(gripper.width_axis)
    assert float(gripper.lower) <= grasp.theta <= grasp.opening <= float(gripper.upper)
    palm = hand.palm(gripper, grasp.pose)
    closed, opened = hand.fingers(gripper, grasp.pose, grasp.theta), hand.fingers(gripper, grasp.pose, grasp.opening)
    normals = []
    for k in np.asarray(gripper.contact):
        gaps = [oracle.distance(piece, origin, *closed[int(k)]) for piece in target.pieces]
        assert abs(min(gaps)) < 1.2e-4
        loose = hand.fingers(gripper, grasp.pose, grasp.theta + 5e-4)[int(k)]
        normals.append(oracle.normal(target.pieces[int(np.argmin(gaps))], origin, *loose))
    own = min(oracle.distance(piece, origin, *part) for piece in target.pieces for part in palm)
    assert own > MARGIN - 1e-6
    assert (
        min(oracle.distance(piece, origin, *part) for piece in target.pieces for part in opened)
        > FINGER_GAP * MARGIN - 1e-6
    )
    around = [
        oracle.distance(obstacle.body.pieces[0], obstacle.pose, part, wxyz_xyz(rigid(scene.target_pose) * rigid(at)))
        for scene in scenes
        for obstacle in scene.obstacles
        for part, at in (*palm, *opened)
    ]
    assert min(around, default=1.0) > MARGIN - 1e-6
    assert grasp.clearance == pytest.approx(min([own, *around]), abs=2e-4)

    turn = Rotation.from_quat(grasp.pose[:4], scalar_first=True)
    parts = [piece.hull_vertices() for piece in target.pieces] + [target.hull_vertices()]
    depth = options.depth * reduce_gripper(gripper).tip_length
    inside = []
    for part in parts:
        planes = ConvexHull(part).equations
        across = np.sqrt(np.maximum(1 - (planes[:, :3] @ turn.apply(axis)) ** 2, 1e-6))
        inside.append((-planes[:, 3] - planes[:, :3] @ grasp.pose[4:] - depth * across).min())
    assert max(inside) > -1e-9
    # Whatever the contact points, the normals alone bound the quality.
    palm_center = grasp.pose[4:] + turn.apply(np.asarray(reduce_gripper(gripper).hand[0].center))
    towards = (target.center_of_mass - palm_center) / np.linalg.norm(target.center_of_mass - palm_center)
    bound = 1 - normals[0] @ normals[1] - 0.5 * (turn.apply(axis) @ towards) ** 2
    assert options.quality_threshold <= grasp.quality < bound + 5e-3


@pytest.mark.parametrize("target", ["box", "can", "stone"], indirect=True)
def test_every_grasp_of_a_union_is_feasible_in_each_scene(panda, scenes, target, hand, coal_oracle):
    result = sample_grasps(target, scenes, panda.gripper, OPTIONS)
    assert (result.evaluations, result.reason) == (OPTIONS.count, None)
    assert len(result.grasps) >= 3
    for grasp in result.grasps[:: max(1, len(result.grasps) // 12)]:
        check(grasp, target, scenes, panda.gripper, hand, coal_oracle)


def test_a_box_in_free_space_is_taken_across_its_narrow_side(panda, bodies, free):
    result = sample_grasps(bodies.box(), [free], panda.gripper, OPTIONS)
    assert len(result.grasps) >= 20
    merits = [0.3 * np.linalg.norm(g.pose[4:]) / 0.08 - g.quality for g in result.grasps]
    assert merits == sorted(merits)
    for grasp in result.grasps:
        closing = Rotation.from_quat(grasp.pose[:4], scalar_first=True).apply([0, 1.0, 0])
        assert abs(closing[0]) > 0.85
        assert 2 * grasp.theta >= bodies.size[0] - 2e-4


def test_what_is_too_large_is_taken_by_its_handle(panda, bodies, free, hand, coal_oracle):
    target = bodies.handled()
    result = sample_grasps(target, [free], panda.gripper, OPTIONS)
    assert len(result.grasps) >= 3
    for grasp in result.grasps[:8]:
        assert grasp.pose[6] > 0.06
        check(grasp, target, [free], panda.gripper, hand, coal_oracle)


def test_too_wide_and_enclosed_targets_are_told_apart(panda, bodies, free, caged):
    wide = sample_grasps(bodies.box((0.09, 0.1, 0.12)), [free], panda.gripper, OPTIONS)
    assert (wide.grasps, wide.reason, wide.evaluations) == ((), NoGraspReason.TOO_WIDE, 0)
    enclosed = sample_grasps(bodies.box((0.05, 0.05, 0.1)), [caged], panda.gripper, OPTIONS)
    expected = ((), NoGraspReason.ENCLOSED, OPTIONS.count)
    assert (enclosed.grasps, enclosed.reason, enclosed.evaluations) == expected


def test_more_samples_find_no_fewer_grasps_and_one_seed_the_same(panda, bodies, scenes):
    few, more, again = (
        sample_grasps(bodies.box(), scenes, panda.gripper, SamplingOptions(count=count, max_grasps=10_000), seed=3)
        for count in (6_000, 20_000, 20_000)
    )
    assert len(more.grasps) >= len(few.grasps) > 0
    # The best of few is among the more, or something like it is.
    assert more.grasps[0].quality >= few.grasps[0].quality - 0.05
    assert len(more.grasps) == len(again.grasps)
    for one, other in zip(more.grasps, again.grasps, strict=True):
        np.testing.assert_array_equal(one.pose, other.pose)
    other_seed = sample_grasps(bodies.box(), scenes, panda.gripper, SamplingOptions(count=6_000), seed=4)
    assert not np.array_equal(other_seed.grasps[0].pose, few.grasps[0].pose)


def closed_by_creeping(target, gripper, pose, width, oracle):
    """θ, pose and contacts after both sliding pads crept up to a convex target from afar, by coal; None if one misses.

    A step of the distance itself never goes too far.
    """
    at, turn = [], rigid(pose).rotation.as_matrix()
    shapes = [oracle.shape(target.pieces[0]), *(oracle.shape(gripper.fingers[k]) for k in range(2))]
    for k, side in enumerate((1.0, -1.0)):
        out = 0.15
        for _ in range(300):
            moved = oracle.placed(turn, pose[4:] + side * out * width)
            gap = oracle.gap(shapes[0], oracle.placed(np.eye(3), np.zeros(3)), shapes[k + 1], moved)
            if gap < 1e-7 or out < -0.1:
                break
            out -= gap
        if gap >= 1e-7:
            return None
        moved = np.concatenate([pose[:4], pose[4:] + side * (out + 1e-4) * width])
        on_target, on_pad = oracle.nearest_points(target.pieces[0], ORIGIN, gripper.fingers[k], moved)
        at.append((out, on_target, (on_pad - on_target) / np.linalg.norm(on_pad - on_target)))
    theta, shift = 0.5 * (at[0][0] + at[1][0]), 0.5 * (at[0][0] - at[1][0])
    return theta, np.concatenate([pose[:4], pose[4:] + shift * width]), at


@pytest.mark.parametrize(("target", "count"), [("can", 1500), ("stone", 1500)], indirect=["target"])
def test_no_bound_dismisses_what_a_plain_judge_accepts(panda, scenes, hand, coal_oracle, target, count):
    """Every sample by coal alone, one after the other, with a little to spare in every rule."""
    gripper, scenes, options = panda.gripper, scenes[:1], SamplingOptions(count=count, max_grasps=count)
    found = sample_grasps(target, scenes, gripper, options, seed=2).grasps
    samples = _Sampler(target, scenes, gripper, options).drawn(2)
    planes = ConvexHull(target.hull_vertices()).equations
    depth = options.depth * reduce_gripper(gripper).tip_length
    accepted = 0
    for i in range(options.count):
        width = samples.poses.width[i]
        closed = closed_by_creeping(
            target, gripper, np.concatenate([samples.poses.quaternion[i], samples.poses.origin[i]]), width, coal_oracle
        )
        if closed is None or not 0 <= closed[0] <= samples.opening[i] - FINGER_GAP * MARGIN - 1e-4:
            continue
        theta, pose, ((_, s1, x1), (_, s2, x2)) = closed
        line = (s1 - s2) / np.linalg.norm(s1 - s2)
        palm = rigid(pose).apply(np.asarray(reduce_gripper(gripper).hand[0].center))
        towards = (target.center_of_mass - palm) / np.linalg.norm(target.center_of_mass - palm)
        quality = x1 @ (line - x2) - 0.5 * (width @ towards) ** 2
        across = np.sqrt(np.maximum(1 - (planes[:, :3] @ width) ** 2, 1e-6))
        inside = (-planes[:, 3] - planes[:, :3] @ pose[4:] - depth * across).min()
        if quality < options.quality_threshold + 5e-3 or inside < 1e-5:
            continue
        palm = hand.palm(gripper, pose)
        opened = hand.fingers(gripper, pose, samples.opening[i])
        gaps = [coal_oracle.distance(target.pieces[0], ORIGIN, *part) - MARGIN for part in palm]
        gaps += [coal_oracle.distance(target.pieces[0], ORIGIN, *part) - FINGER_GAP * MARGIN for part in opened]
        for scene in scenes:
            for obstacle in scene.obstacles:
                piece, place = obstacle.body.pieces[0], wxyz_xyz(rigid(scene.target_pose).inv() * rigid(obstacle.pose))
                gaps += [coal_oracle.distance(piece, place, *part) - MARGIN for part in (*palm, *opened)]
                gaps += [coal_oracle.distance(piece, place, *part) for part in hand.fingers(gripper, pose, theta)]
        if min(gaps) > 2e-4:
            accepted += 1
            turns = [abs(grasp.pose[:4] @ pose[:4]) > np.cos(0.5 * ALIKE_ANGLE) - 1e-6 for grasp in found]
            shifts = [np.linalg.norm(grasp.pose[4:] - pose[4:]) < ALIKE_SHIFT * 0.08 + 1e-4 for grasp in found]
            assert (np.array(turns) & np.array(shifts)).any()
    assert accepted >= 3
