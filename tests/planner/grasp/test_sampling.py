"""The sampling baseline: every grasp it gives against coal, its bounds against what they bound, and known answers."""

import coal
import jaxlie
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import RigidTransform, Rotation

from regrasp_planner.collision.fixed_bodies import FixedBodies
from regrasp_planner.geometry.hull import hull_planes
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.grasp.closing import TOLERANCE, Pads, Poses, close_fingers, reaches
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
from regrasp_planner.robot.model import Gripper
from regrasp_planner.task import Body, Scene

OPTIONS = SamplingOptions(count=20_000)
MARGIN = OPTIONS.margin * 0.08
SIZE = np.array([0.048, 0.093, 0.176])
ORIGIN = np.array([1.0, 0, 0, 0, 0, 0, 0])


def box(size=SIZE, name="box"):
    return Body(name, (ConvexBody.box(size),), np.zeros(3), 0.5)


def prism(radius=0.033, height=0.1, sides=24):
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], 1)
    points = np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (-height / 2, height / 2)])
    return Body("can", (ConvexBody.from_vertices(points),), np.zeros(3), 0.3)


def stone(seed=1, count=20):
    points = np.random.default_rng(seed).normal(size=(count, 3)) * [0.015, 0.018, 0.03]
    body = ConvexBody.from_vertices(points)
    return Body("stone", (body,), np.asarray(body.center), 0.2)


def handled():
    """Too large to take but by its handle."""
    block = ConvexBody.box((0.12, 0.12, 0.12))
    handle = ConvexBody.from_vertices(block.hull_vertices() * [0.15, 0.6, 0.5] + [0.0, 0.0, 0.09])
    return Body("handled", (block, handle), np.array([0.0, 0.0, 0.01]), 0.5)


@pytest.fixture
def scenes(build):
    """A target lying on a table, and standing on a shelf board."""
    table = build.box_obstacle("table", (1.2, 1.6, 0.05), (0.4, 0, -0.025))
    board = build.box_obstacle("board", (0.3, 0.5, 0.02), (0.6, 0.4, 0.19))
    roof = build.box_obstacle("roof", (0.3, 0.5, 0.02), (0.6, 0.4, 0.57))
    post = build.box_obstacle("post", (0.06, 0.06, 0.1), (0.5, -0.42, 0.05), (0.3, 0.2, 0.1))
    world = (table, board, roof, post)
    lying = build.pose((0.5, -0.3, SIZE[1] / 2), (np.pi / 2, 0, 0))
    standing = build.pose((0.58, 0.4, 0.2 + SIZE[2] / 2), (0, 0, np.pi / 2))
    return Scene("pick", lying, world), Scene("place", standing, world)


_SHAPES = {}


def shape(body):
    """The hull of a body as coal has it, without the sweep."""
    vertices = body.hull_vertices()
    key = vertices.tobytes()
    if key not in _SHAPES:
        _SHAPES[key] = _shape(vertices)
    return _SHAPES[key]


def _shape(vertices):
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(list(vertices))
    triangles.extend([coal.Triangle(*map(int, simplex)) for simplex in ConvexHull(vertices).simplices])
    return coal.Convex(points, triangles)


def exact(first, first_pose, second, second_pose):
    """Signed distance of two bodies by coal, metres."""
    placed = [coal.Transform3s(rigid(p).rotation.as_matrix(), np.asarray(p)[4:]) for p in (first_pose, second_pose)]
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    request.enable_signed_distance = True
    coal.distance(shape(first), placed[0], shape(second), placed[1], request, result)
    return result.min_distance - float(first.radius) - float(second.radius)


def nearest(first, first_pose, second, second_pose):
    """The nearest points of two bodies that are apart, by coal."""
    placed = [coal.Transform3s(rigid(p).rotation.as_matrix(), np.asarray(p)[4:]) for p in (first_pose, second_pose)]
    result = coal.DistanceResult()
    coal.distance(shape(first), placed[0], shape(second), placed[1], coal.DistanceRequest(), result)
    return result.getNearestPoint1(), result.getNearestPoint2()


def normal(*pair):
    """Unit normal from the first body to the second, by coal; they have to be apart."""
    one, two = nearest(*pair)
    return (two - one) / np.linalg.norm(two - one)


def fingers(gripper, pose, theta):
    """Finger bodies of the gripper with their poses, straight from the robot's description."""
    moved = np.asarray(gripper.finger_motion(theta))
    return [(gripper.fingers[k], wxyz_xyz(rigid(pose) * rigid(moved[k]))) for k in range(gripper.fingers.batch_size)]


def check(grasp, target, scenes, gripper, options=OPTIONS):
    """That a grasp keeps every rule, by coal and by plain geometry."""
    origin, axis = ORIGIN, np.asarray(gripper.width_axis)
    assert float(gripper.lower) <= grasp.theta <= grasp.opening <= float(gripper.upper)
    palm = [(gripper.palm[k], grasp.pose) for k in range(gripper.palm.batch_size)]
    closed, opened = fingers(gripper, grasp.pose, grasp.theta), fingers(gripper, grasp.pose, grasp.opening)
    normals = []
    for k in np.asarray(gripper.contact):
        gaps = [exact(piece, origin, *closed[int(k)]) for piece in target.pieces]
        assert abs(min(gaps)) < 1.2e-4
        loose = fingers(gripper, grasp.pose, grasp.theta + 5e-4)[int(k)]
        normals.append(normal(target.pieces[int(np.argmin(gaps))], origin, *loose))
    own = min(exact(piece, origin, *part) for piece in target.pieces for part in palm)
    assert own > MARGIN - 1e-6
    assert min(exact(piece, origin, *part) for piece in target.pieces for part in opened) > FINGER_GAP * MARGIN - 1e-6
    around = [
        exact(obstacle.body.pieces[0], obstacle.pose, part, wxyz_xyz(rigid(scene.target_pose) * rigid(at)))
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


@pytest.mark.parametrize("target", [box(), prism(), stone()], ids=lambda body: body.name)
def test_every_grasp_of_a_union_is_feasible_in_each_scene(panda, scenes, target):
    result = sample_grasps(target, scenes, panda.gripper, OPTIONS)
    assert (result.evaluations, result.reason) == (OPTIONS.count, None)
    assert len(result.grasps) >= 3
    for grasp in result.grasps[:: max(1, len(result.grasps) // 12)]:
        check(grasp, target, scenes, panda.gripper)


def test_a_box_in_free_space_is_taken_across_its_narrow_side(panda, build):
    free = Scene("free", build.pose(), ())
    result = sample_grasps(box(), [free], panda.gripper, OPTIONS)
    assert len(result.grasps) >= 20
    merits = [0.3 * np.linalg.norm(g.pose[4:]) / 0.08 - g.quality for g in result.grasps]
    assert merits == sorted(merits)
    for grasp in result.grasps:
        closing = Rotation.from_quat(grasp.pose[:4], scalar_first=True).apply([0, 1.0, 0])
        assert abs(closing[0]) > 0.85
        assert 2 * grasp.theta >= SIZE[0] - 2e-4


def test_what_is_too_large_is_taken_by_its_handle(panda, build):
    free, target = Scene("free", build.pose(), ()), handled()
    result = sample_grasps(target, [free], panda.gripper, OPTIONS)
    assert len(result.grasps) >= 3
    for grasp in result.grasps[:8]:
        assert grasp.pose[6] > 0.06
        check(grasp, target, [free], panda.gripper)


def test_too_wide_and_enclosed_targets_are_told_apart(panda, build):
    free = Scene("free", build.pose(), ())
    wide = sample_grasps(box((0.09, 0.1, 0.12)), [free], panda.gripper, OPTIONS)
    assert (wide.grasps, wide.reason, wide.evaluations) == ((), "too wide", 0)
    walls = tuple(
        build.box_obstacle(f"wall{k}", np.where(np.arange(3) == k // 2, 0.02, 0.5), 0.1 * (-1) ** k * np.eye(3)[k // 2])
        for k in range(6)
    )
    caged = sample_grasps(box((0.05, 0.05, 0.1)), [Scene("cage", build.pose(), walls)], panda.gripper, OPTIONS)
    assert (caged.grasps, caged.reason, caged.evaluations) == ((), "enclosed", OPTIONS.count)


def test_more_samples_find_no_fewer_grasps_and_one_seed_the_same(panda, scenes):
    few, more, again = (
        sample_grasps(box(), scenes, panda.gripper, SamplingOptions(count=count, max_grasps=10_000), seed=3)
        for count in (6_000, 20_000, 20_000)
    )
    assert len(more.grasps) >= len(few.grasps) > 0
    # The best of few is among the more, or something like it is.
    assert more.grasps[0].quality >= few.grasps[0].quality - 0.05
    assert len(more.grasps) == len(again.grasps)
    for one, other in zip(more.grasps, again.grasps, strict=True):
        np.testing.assert_array_equal(one.pose, other.pose)
    other_seed = sample_grasps(box(), scenes, panda.gripper, SamplingOptions(count=6_000), seed=4)
    assert not np.array_equal(other_seed.grasps[0].pose, few.grasps[0].pose)


def closed_by_creeping(target, gripper, pose, width):
    """θ, pose and contacts after both sliding pads crept up to a convex target from afar, by coal; None if one misses.

    A step of the distance itself never goes too far.
    """
    at, turn, request = [], rigid(pose).rotation.as_matrix(), coal.DistanceRequest()
    shapes = [shape(target.pieces[0]), *(shape(gripper.fingers[k]) for k in range(2))]
    for k, side in enumerate((1.0, -1.0)):
        out = 0.15
        for _ in range(300):
            moved = coal.Transform3s(turn, pose[4:] + side * out * width)
            gap = coal.distance(shapes[0], coal.Transform3s(), shapes[k + 1], moved, request, coal.DistanceResult())
            if gap < 1e-7 or out < -0.1:
                break
            out -= gap
        if gap >= 1e-7:
            return None
        moved = np.concatenate([pose[:4], pose[4:] + side * (out + 1e-4) * width])
        on_target, on_pad = nearest(target.pieces[0], ORIGIN, gripper.fingers[k], moved)
        at.append((out, on_target, (on_pad - on_target) / np.linalg.norm(on_pad - on_target)))
    theta, shift = 0.5 * (at[0][0] + at[1][0]), 0.5 * (at[0][0] - at[1][0])
    return theta, np.concatenate([pose[:4], pose[4:] + shift * width]), at


@pytest.mark.parametrize(("target", "count"), [(prism(), 1500), (stone(), 1500)], ids=["can", "stone"])
def test_no_bound_dismisses_what_a_plain_judge_accepts(panda, scenes, target, count):
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
            target, gripper, np.concatenate([samples.poses.quaternion[i], samples.poses.origin[i]]), width
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
        hand = [(gripper.palm[k], pose) for k in range(gripper.palm.batch_size)]
        opened = fingers(gripper, pose, samples.opening[i])
        gaps = [exact(target.pieces[0], ORIGIN, *part) - MARGIN for part in hand]
        gaps += [exact(target.pieces[0], ORIGIN, *part) - FINGER_GAP * MARGIN for part in opened]
        for scene in scenes:
            for obstacle in scene.obstacles:
                piece, place = obstacle.body.pieces[0], wxyz_xyz(rigid(scene.target_pose).inv() * rigid(obstacle.pose))
                gaps += [exact(piece, place, *part) - MARGIN for part in (*hand, *opened)]
                gaps += [exact(piece, place, *part) for part in fingers(gripper, pose, theta)]
        if min(gaps) > 2e-4:
            accepted += 1
            turns = [abs(grasp.pose[:4] @ pose[:4]) > np.cos(0.5 * ALIKE_ANGLE) - 1e-6 for grasp in found]
            shifts = [np.linalg.norm(grasp.pose[4:] - pose[4:]) < ALIKE_SHIFT * 0.08 + 1e-4 for grasp in found]
            assert (np.array(turns) & np.array(shifts)).any()
    assert accepted >= 3


def drawn_poses(rng, count, spread):
    turn = Rotation.random(count, rng=rng)
    return Poses(turn.as_quat(scalar_first=True), rng.normal(size=(count, 3)) * spread, turn.apply([0, 1.0, 0]))


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**31))
def test_fingers_close_until_both_touch_and_lines_bound_how_far(panda, seed):
    rng = np.random.default_rng(seed)
    target, count = stone(seed, 30), 64
    piece, gripper, pads = target.pieces[0], panda.gripper, Pads.of(panda.gripper)
    poses = drawn_poses(rng, count, 0.008)
    travel, touched = reaches([hull_planes(piece.hull_vertices())], np.ones(count, int), pads, poses)
    hit = np.flatnonzero(np.isfinite(travel).all(axis=1))
    poses = Poses(*(leaf[hit] for leaf in poses))
    theta, shift = pads.nearly(travel[hit], 0.04)
    found = close_fingers([piece], touched[hit], gripper, poses, theta, shift)
    met = np.flatnonzero((np.abs(found.gaps) < TOLERANCE).all(axis=1))
    assert len(met) > 0.95 * len(hit) > 5
    assert (found.theta[met] > theta[met] - 1e-6).all()
    for i in met[:6]:
        pose = np.concatenate([poses.quaternion[i], poses.origin[i] + found.shift[i] * poses.width[i]])
        for body, at in fingers(gripper, pose, found.theta[i]):
            assert abs(exact(piece, ORIGIN, body, at)) < 1e-4


def jaws():
    """Two jaws that swing about hinges 4 cm to either side of the palm; θ is the angle of each."""
    pad = np.array([[x, y, z] for x in (-0.02, 0.02) for y in (0.0, 0.01) for z in (-0.02, 0.02)])
    screws = []
    for side in (1.0, -1.0):
        hinge, axis = np.array([0.0, 0.04 * side, -0.12]), np.array([-side, 0.0, 0.0])
        screws.append([*-np.cross(axis, hinge), *axis])
    bodies = [ConvexBody.from_vertices(pad * [1, side, 1]) for side in (1.0, -1.0)]
    return Gripper(
        palm=ConvexBody.stack(
            [ConvexBody.box((0.05, 0.12, 0.02)).transformed(jaxlie.SE3(ORIGIN - [0, 0, 0, 0, 0, 0, 0.13]))]
        ),
        fingers=ConvexBody.stack(bodies),
        finger_of=np.array([0, 1]),
        contact=np.array([0, 1]),
        screws=np.array(screws),
        lower=np.array(-0.1),
        upper=np.array(0.6),
        width_axis=np.array([0, 1.0, 0]),
        approach_axis=np.array([0, 0, 1.0]),
        max_opening=np.array(0.12),
    )


def test_swinging_jaws_close_until_both_touch():
    rng, gripper, target = np.random.default_rng(5), jaws(), stone(4, 30)
    pads, count = Pads.of(gripper), 128
    assert not pads.slide
    poses = drawn_poses(rng, count, 0.004)
    piece = target.pieces[0]
    travel, touched = reaches([hull_planes(piece.hull_vertices())], np.zeros(count, int), pads, poses)
    start = pads.nearly(np.where(np.isfinite(travel), travel, 0.0), float(gripper.upper))
    found = close_fingers([piece], touched, gripper, poses, *start)
    met = np.flatnonzero((np.abs(found.gaps) < TOLERANCE).all(axis=1))
    assert len(met) > 0.9 * count
    for i in met[::16]:
        pose = np.concatenate([poses.quaternion[i], poses.origin[i] + found.shift[i] * poses.width[i]])
        for body, at in fingers(gripper, pose, found.theta[i]):
            assert abs(exact(piece, ORIGIN, body, at)) < 1e-4


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**31), cap=st.sampled_from([0.0, 1.0]))
def test_least_slack_is_that_of_the_nearest_pair(seed, cap):
    rng = np.random.default_rng(seed)
    count, needed = 12, rng.uniform(-0.002, 0.01, (2, 3))
    moving = [ConvexBody.from_vertices(rng.normal(size=(10, 3)) * 0.01), ConvexBody.capsule(0.01, 0.03)]
    bodies = [ConvexBody.from_vertices(rng.normal(size=(n, 3)) * 0.02) for n in (8, 30, 60)]
    turns = Rotation.random(3, rng=rng).as_quat(scalar_first=True)
    poses = np.concatenate([turns, rng.normal(size=(3, 3)) * 0.05], axis=1)
    placed = [
        RigidTransform.from_components(rng.normal(size=(count, 3)) * 0.06, Rotation.random(count, rng=rng))
        for _ in moving
    ]
    found = FixedBodies(bodies, poses).least_slack(moving, placed, needed, cap)
    for i in range(count):
        slack = min(
            exact(moving[m], wxyz_xyz(placed[m][i]), bodies[w], poses[w]) - needed[m, w]
            for m in range(2)
            for w in range(3)
        )
        assert found[i] <= min(slack, cap) + 1e-9 or (found[i] < 0 and slack < 0)
        assert found[i] > min(slack, cap) - 2e-4 or slack < 0
