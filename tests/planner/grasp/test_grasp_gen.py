"""GraspGen against finite differences, exact distances and problems whose answer is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from regrasp_planner.geometry.boxes import bounding_boxes
from regrasp_planner.geometry.distance import certified_distance
from regrasp_planner.geometry.hull import clip_lines, hull_planes
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.grasp.broad_phase import overlaps
from regrasp_planner.grasp.closing_axes import closing_axes
from regrasp_planner.grasp.grasp import GraspGenOptions, StartKind
from regrasp_planner.grasp.grasp_gen import PATIENCE, GraspSearch, generate_grasps
from regrasp_planner.grasp.objective import grasp_objective
from regrasp_planner.grasp.problem import grasp_problem
from regrasp_planner.grasp.starts import grasp_starts
from regrasp_planner.optim.manifold import SE3, Euclidean, Product
from regrasp_planner.placement.tilted_release import ReleaseCone, plane_clearance
from regrasp_planner.pose import rigid, wxyz_xyz
from regrasp_planner.robot.gripper import gripper_corners, reduce_gripper
from regrasp_planner.task import Body, Scene

OPTIONS = GraspGenOptions()
SIZE = np.array([0.048, 0.093, 0.176])


def box(size=SIZE, name="box"):
    return Body(name, (ConvexBody.box(size),), np.zeros(3), 0.5)


def prism(radius=0.033, height=0.1, sides=24):
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], 1)
    points = np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (-height / 2, height / 2)])
    return Body("can", (ConvexBody.from_vertices(points),), np.zeros(3), 0.3)


@pytest.fixture
def scenes(build):
    """A box lying on a narrow side on a table, and standing on a shelf board."""
    table = build.box_obstacle("table", (1.2, 1.6, 0.05), (0.4, 0, -0.025))
    board = build.box_obstacle("board", (0.3, 0.5, 0.02), (0.6, 0.4, 0.19))
    roof = build.box_obstacle("roof", (0.3, 0.5, 0.02), (0.6, 0.4, 0.57))
    post = build.box_obstacle("post", (0.06, 0.06, 0.1), (0.5, -0.42, 0.05))
    world = (table, board, roof, post)
    lying = build.pose((0.5, -0.3, SIZE[1] / 2), (np.pi / 2, 0, 0))
    standing = build.pose((0.58, 0.4, 0.2 + SIZE[2] / 2), (0, 0, np.pi / 2))
    return Scene("pick", lying, world), Scene("place", standing, world)


def gap(first, first_pose, second, second_pose):
    """Rigorous lower bound of the distance of two bodies' hulls."""
    a, b = ConvexBody.stack([first]), ConvexBody.stack([second])
    return float(certified_distance(a, jnp.asarray(first_pose)[None], b, jnp.asarray(second_pose)[None])[0])


def gripper_bodies(gripper, pose, theta):
    """All bodies of the gripper with their poses, straight from the robot's description."""
    palm = [(gripper.palm[k], pose) for k in range(gripper.palm.batch_size)]
    moved = np.asarray(gripper.finger_motion(theta))
    fingers = [(gripper.fingers[k], wxyz_xyz(rigid(pose) * rigid(moved[k]))) for k in range(gripper.fingers.batch_size)]
    return palm, fingers


@pytest.mark.parametrize("seed", range(4))
def test_derivatives_of_the_problem_match_finite_differences(panda, scenes, seed):
    problem = grasp_problem(box(), scenes, panda.gripper, OPTIONS)
    rng = np.random.default_rng(seed)
    quaternion = rng.normal(size=4)
    pose = np.concatenate([quaternion / np.linalg.norm(quaternion), rng.normal(scale=0.08, size=3)])
    point = (jnp.asarray(pose), jnp.asarray([0.4]))
    manifold = Product((SE3(length=0.08), Euclidean(1)))

    def flat(xi):
        value, equalities, inequalities = grasp_objective(manifold.retract(point, xi), problem)
        return jnp.concatenate([value[None], equalities, inequalities])

    evaluate = jax.jit(flat)
    exact = np.asarray(jax.jit(jax.jacfwd(flat))(jnp.zeros(7)))
    step = 1e-6
    numeric = np.stack(
        [(np.asarray(evaluate(step * e)) - np.asarray(evaluate(-step * e))) / (2 * step) for e in np.eye(7)], axis=1
    )
    # Obstacles that only pad the batch are a kilometre away, where rounding of the values alone is larger.
    near = np.abs(np.asarray(evaluate(np.zeros(7)))) < 100
    scale = np.maximum(np.abs(exact[near]).max(axis=1, keepdims=True), 1.0)
    assert near.sum() > 10
    np.testing.assert_array_less(np.abs(exact[near] - numeric[near]) / scale, 1e-5)


def test_closing_axes_of_a_box_are_its_narrow_directions():
    hull = box().hull_vertices()
    axes, widths = closing_axes(hull, 0.08, OPTIONS.max_axes)
    assert len(axes) == 1
    np.testing.assert_allclose(np.abs(axes[0]), [1, 0, 0], atol=1e-12)
    assert widths[0] == pytest.approx(SIZE[0])
    axes, widths = closing_axes(hull, 0.2, OPTIONS.max_axes)
    np.testing.assert_allclose(np.abs(axes), np.eye(3), atol=1e-12)
    np.testing.assert_allclose(widths, SIZE)


def test_closing_axes_of_a_can_spread_round_it():
    axes, widths = closing_axes(prism().hull_vertices(), 0.08, OPTIONS.max_axes)
    assert 6 <= len(axes) <= OPTIONS.max_axes
    np.testing.assert_allclose(axes[:, 2], 0, atol=1e-9)
    np.testing.assert_allclose(widths, 2 * 0.033 * np.cos(np.pi / 24))
    directions = np.sort(np.degrees(np.arctan2(axes[:, 1], axes[:, 0])) % 180)
    assert np.diff(directions, append=directions[0] + 180).max() < 45


@pytest.mark.parametrize("seed", range(5))
def test_closing_axes_are_the_local_minima_of_the_width(seed):
    """On random hulls: no wider a step away, and descent from anywhere ends at one of them."""
    rng = np.random.default_rng(seed)
    hull = rng.normal(size=(20, 3)) * [0.02, 0.03, 0.04]
    axes, widths = closing_axes(hull, np.inf, 1000)

    def width(x):
        return np.ptp(hull @ np.asarray(x).T, axis=0)

    np.testing.assert_allclose(width(axes), widths)
    for axis, least in zip(axes, widths, strict=True):
        steps = axis + 1e-4 * rng.normal(size=(200, 3))
        assert (width(steps / np.linalg.norm(steps, axis=1, keepdims=True)) > least - 1e-12).all()
    starts = rng.normal(size=(40, 3))
    for x in starts / np.linalg.norm(starts, axis=1, keepdims=True):
        size = 0.3
        while size > 1e-5:
            trial = x + size * rng.normal(size=(60, 3))
            trial /= np.linalg.norm(trial, axis=1, keepdims=True)
            best = trial[width(trial).argmin()]
            x, size = (best, size) if width(best) < width(x) else (x, 0.7 * size)
        assert np.abs(axes @ x).max() > np.cos(np.radians(3.5))


@pytest.mark.parametrize("seed", range(5))
def test_leaning_axes_come_after_the_minima_and_lean_no_more_than_told(seed):
    hull = np.random.default_rng(seed).normal(size=(20, 3)) * [0.02, 0.03, 0.04]
    minima, widths = closing_axes(hull, np.inf, 1000)
    axes, all_widths = closing_axes(hull, np.inf, 1000, lean=0.25)
    assert len(axes) > len(minima)
    np.testing.assert_array_equal(axes[: len(minima)], minima)
    np.testing.assert_array_equal(all_widths[: len(minima)], widths)
    differences = (hull[:, None] - hull[None]).reshape(-1, 3)
    for k, (axis, width) in enumerate(zip(axes, all_widths, strict=True)):
        heights = differences @ axis
        assert heights.max() == pytest.approx(width)
        # The lines between contacts that this axis allows, and the one of them that leans least.
        between = differences[heights > width - 1e-9]
        assert np.linalg.matrix_rank(between[1:] - between[0], tol=1e-6) == 2
        weights, _ = nnls(np.vstack([between.T, 1e3 * np.ones(len(between))]), [0, 0, 0, 1e3])
        nearest = weights @ between
        leaning = np.arccos(np.clip(width / np.linalg.norm(nearest), -1, 1))
        # Beyond a corner of the facet it leans more than over the edge.
        assert leaning < (1e-3 if k < len(minima) else 2 * 0.25)


@pytest.mark.parametrize("seed", range(4))
def test_lines_are_clipped_by_a_hull_where_they_pierce_it(seed):
    """Just inside of both ends a point is in the hull, just outside it is not; lines that miss say so."""
    rng = np.random.default_rng(seed)
    hull = rng.normal(size=(25, 3))
    planes = hull_planes(hull)
    points = 1.5 * rng.normal(size=(40, 5, 3))
    directions = rng.normal(size=(40, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    enter, leave = clip_lines(points, directions, planes)
    hit = np.isfinite(enter)
    assert 20 < hit.sum() < 190
    np.testing.assert_array_equal(hit, np.isfinite(leave))

    def depth(t):
        at = points + t[..., None] * directions[:, None]
        return (planes[:, 3] - at @ planes[:, :3].T).min(axis=-1)

    for end, inward in ((enter, 1e-6), (leave, -1e-6)):
        safe = np.where(hit, end, 0.0)
        assert (depth(safe + inward)[hit] > -1e-12).all()
        assert (depth(safe - inward)[hit] < 1e-12).all()
    along = np.linspace(-6, 6, 400)
    inside = np.stack([depth(np.full(hit.shape, t)) for t in along]).max(axis=0)
    assert (inside[~hit] < 0).all()


@pytest.mark.parametrize("body", [box(), prism()], ids=["box", "can"])
def test_starts_touch_with_both_pads_and_keep_the_palm_off(panda, body):
    hull, gripper = body.hull_vertices(), panda.gripper
    axes, _ = closing_axes(hull, 0.08, 4)
    starts = grasp_starts([hull], 0, axes, gripper, 12, 0.005)
    palm = reduce_gripper(gripper).hand[0]
    deep = np.flatnonzero(starts.depths > 0.005)
    assert len(deep) > 20
    for pose, theta in list(zip(starts.poses[deep], starts.thetas[deep], strict=True))[::5]:
        assert gap(palm, pose, body.pieces[0], [1, 0, 0, 0, 0, 0, 0]) > 2e-3
        _, fingers = gripper_bodies(gripper, pose, theta)
        for k in np.asarray(gripper.contact):
            assert abs(gap(body.pieces[0], [1, 0, 0, 0, 0, 0, 0], *fingers[int(k)])) < 4e-4


def test_bounding_boxes_overlap_where_the_bodies_do(panda, build):
    """Corners inside of a box make them overlap, and they are never farther apart than the bodies in them."""
    gripper = panda.gripper
    rng = np.random.default_rng(0)
    quaternions = rng.normal(size=(200, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    poses = np.concatenate([quaternions, rng.normal(scale=0.12, size=(200, 3))], axis=1)
    opened = np.full(200, 0.03)
    block = ConvexBody.stack([ConvexBody.box((0.1, 0.06, 0.04))])
    total, least = overlaps(poses, opened, gripper, bounding_boxes(block), build.pose()[None], 0.005)
    corners = np.concatenate(gripper_corners(gripper, poses, opened), axis=1)
    inside = (np.abs(corners) < [0.05, 0.03, 0.02]).all(axis=2).any(axis=1)
    assert inside.sum() > 10
    assert (least[inside] <= 0).all()
    assert ((total == 0) == (least >= 0.005)).all()
    for pose, size in zip(poses[::20], least[::20], strict=True):
        palm, fingers = gripper_bodies(gripper, pose, 0.03)
        # Boxes are larger than what is in them.
        assert min(gap(block[0], build.pose(), *part) for part in (*palm, *fingers)) >= size - 1e-6


@pytest.mark.parametrize("body", [box(), prism()], ids=["box", "can"])
def test_grasps_hold_the_target_between_opposite_faces(panda, build, body):
    """In free space: pads touch, on opposite sides, and nothing else of the gripper does."""
    free = Scene("free", build.pose(), ())
    result = generate_grasps(body, [free], panda.gripper)
    assert len(result.grasps) >= 4
    gripper, piece, origin = panda.gripper, body.pieces[0], build.pose()
    for grasp in result.grasps:
        assert grasp.quality >= OPTIONS.quality_threshold
        assert 0 <= grasp.theta <= grasp.opening <= 0.04
        palm, fingers = gripper_bodies(gripper, grasp.pose, grasp.theta)
        for k in np.asarray(gripper.contact):
            assert abs(gap(piece, origin, *fingers[int(k)])) < 2.5e-3
        assert min(gap(piece, origin, *part) for part in palm) > 0
        palm, fingers = gripper_bodies(gripper, grasp.pose, grasp.opening)
        assert min(gap(piece, origin, *part) for part in fingers) > 1e-3
        # The line between the contacts is the closing axis, and normal to the surface there.
        closing = Rotation.from_quat(grasp.pose[:4], scalar_first=True).apply(np.asarray(gripper.width_axis))
        width = np.ptp(body.hull_vertices() @ closing)
        assert width < 2 * grasp.theta + 2e-3


def test_grasps_of_a_union_hold_in_each_scene(panda, scenes):
    body = box()
    result = generate_grasps(body, scenes, panda.gripper)
    assert len(result.grasps) >= 3
    margin = OPTIONS.margin * 0.08
    for grasp in result.grasps:
        for scene in scenes:
            pose = grasp.gripper_pose(scene.target_pose)
            palm, fingers = gripper_bodies(panda.gripper, pose, grasp.opening)
            for obstacle in scene.obstacles:
                for part in (*palm, *fingers):
                    distance = gap(obstacle.body.pieces[0], obstacle.pose, *part)
                    assert distance > margin - 3e-4, (scene.name, obstacle.body.name)


def test_too_wide_and_enclosed_targets_are_told_apart(panda, build):
    free = Scene("free", build.pose(), ())
    wide = generate_grasps(box((0.09, 0.1, 0.12)), [free], panda.gripper)
    assert (wide.grasps, wide.reason, wide.evaluations) == ((), "too wide", 0)
    walls = tuple(
        build.box_obstacle(f"wall{k}", np.where(np.arange(3) == k // 2, 0.02, 0.5), 0.1 * (-1) ** k * np.eye(3)[k // 2])
        for k in range(6)
    )
    caged = generate_grasps(box((0.05, 0.05, 0.1)), [Scene("cage", build.pose(), walls)], panda.gripper)
    assert (caged.grasps, caged.reason) == ((), "enclosed")
    assert caged.evaluations > 0


def test_searching_again_over_other_ground_evaluates_only_what_is_new(panda, scenes):
    search = GraspSearch(box(), scenes[:1], panda.gripper)
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
def test_grasps_clear_the_ground_they_are_asked_for(panda, down):
    """In every pose of a box in which it can be taken, statically and with a tilt within the cone."""
    body, down = box(), np.array(down)
    search, margin = GraspSearch(body, (), panda.gripper), OPTIONS.margin * 0.08
    upright = [found for batch in search.grasps(end=ReleaseCone(down, 0.0)) for found in batch]
    tilted = [found for batch in search.grasps(end=ReleaseCone(down, 0.3)) for found in batch]
    assert len(tilted) >= len(upright)
    # Closing from above and below, one finger would be under the box as it settles.
    assert bool(tilted) == (abs(down[0]) < 1)
    for found in [*upright, *tilted]:
        opening = np.array([found.grasp.opening])
        corners = np.concatenate(gripper_corners(panda.gripper, found.grasp.pose[None], opening), axis=1)
        assert plane_clearance(body.hull_vertices(), corners, found.release[None])[0] > margin - 1e-6
        assert np.arccos(np.clip(found.release @ down, -1, 1)) < 0.3 + 1e-6
    assert all(found.release @ down > 1 - 1e-12 for found in upright)


def test_plain_multi_start_finds_grasps_too_but_for_more_evaluations(panda, scenes):
    critical = generate_grasps(box(), scenes, panda.gripper, GraspGenOptions(enough=1))
    options = GraspGenOptions(starts=StartKind.UNIFORM, refined=24, max_evaluations=24, budget=2000, enough=1)
    uniform = generate_grasps(box(), scenes, panda.gripper, options)
    assert critical.grasps
    assert uniform.evaluations > critical.evaluations
    for grasp in uniform.grasps:
        assert grasp.quality >= options.quality_threshold


def test_same_problem_same_grasps(panda, scenes):
    first, second = (generate_grasps(box(), scenes, panda.gripper) for _ in range(2))
    assert first.evaluations == second.evaluations
    for a, b in zip(first.grasps, second.grasps, strict=True):
        np.testing.assert_array_equal(a.pose, b.pose)
