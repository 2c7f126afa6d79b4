"""Non-static release: the nearest plane that a gripper clears, and whether the gripper is in the way afterwards."""

import coal
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from regrasp_planner import stable_poses
from regrasp_planner.optim.augmented_lagrangian import Options, augmented_lagrangian
from regrasp_planner.optim.manifold import Euclidean
from regrasp_planner.placement.release_pose import resting_poses
from regrasp_planner.placement.stab_pose import fibonacci_sphere
from regrasp_planner.placement.tilted_release import (
    SETTLING_STEPS,
    ReleaseCone,
    perturbed_plane,
    plane_clearance,
    relaxed_release,
    settling_clearance,
)
from regrasp_planner.pose import rigid
from regrasp_planner.task import ReleaseArea

CUBE = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)
SEEDS = st.integers(0, 2**31)


def random_hull(rng, count=16):
    vertices = rng.normal(size=(count, 3))
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True) * rng.uniform(0.4, 1, 3) * 0.05


def directions(rng, *shape):
    x = rng.normal(size=(*shape, 3))
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def around(axis, angles, rng):
    """Directions at the given angles from the axis, each at a random side."""
    side = np.cross(axis, directions(rng, len(angles)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return np.cos(angles)[:, None] * axis + np.sin(angles)[:, None] * side


def a_grip(rng, grippers=8):
    """A target, its most stable direction, and grippers of 24 points beside and above it."""
    vertices = random_hull(rng)
    poses = stable_poses(vertices)
    middle = directions(rng, grippers, 1) * rng.uniform(0.02, 0.07, (grippers, 1, 1))
    return poses.corners, poses.directions[0], middle + 0.015 * rng.normal(size=(grippers, 24, 3))


def angle(a, b):
    return 2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))


@settings(deadline=None, max_examples=40)
@given(SEEDS, st.floats(0, 0.01))
def test_the_perturbed_plane_solves_eq_9_nearer_than_any_direction_of_a_grid(seed, delta):
    rng = np.random.default_rng(seed)
    target, axis, gripper = a_grip(rng)
    x = perturbed_plane(target, gripper, axis, delta)
    np.testing.assert_allclose(np.linalg.norm(x, axis=1), 1, atol=1e-12)
    start = plane_clearance(target, gripper, np.broadcast_to(axis, x.shape)) - delta
    h = plane_clearance(target, gripper, x) - delta
    grid = fibonacci_sphere(20000)
    grid = grid[grid @ axis > 0]
    lowest = (grid @ target.T).max(axis=1)
    for k in range(len(x)):
        clear = lowest - (grid @ gripper[k].T).max(axis=1) >= delta
        nearest = angle(grid[clear], axis).min() if clear.any() else np.inf
        if start[k] >= 0:
            np.testing.assert_array_equal(x[k], axis)
        elif h[k] > -1e-9:
            assert abs(h[k]) < 1e-9
            assert angle(x[k], axis) <= nearest + 1e-9
        else:
            assert nearest == np.inf


@jax.jit
def descend_eq_9(target, gripper, delta, starts):
    """Ends (K, S, 3) of the trust region on ½ H² from S starts for each of K grippers."""

    def problem(x, points):
        x = x / jnp.linalg.norm(x)
        # In centimetres, which suits the solver's tolerance.
        value = 0.5 * (100 * ((target @ x).max() - (points @ x).max() - delta)) ** 2
        return value, jnp.zeros(0), jnp.zeros(0)

    def solve(points, start):
        options = Options(80, gradient_tolerance=1e-8)
        x = augmented_lagrangian(problem, start, Euclidean(3), options, params=points, counts=(0, 0)).point
        return x / jnp.linalg.norm(x)

    return jax.vmap(lambda points: jax.vmap(lambda start: solve(points, start))(starts))(gripper)


@settings(deadline=None, max_examples=20)
@given(SEEDS)
def test_no_trust_region_on_eq_9_ends_nearer(seed):
    rng = np.random.default_rng(seed)
    target, axis, gripper = a_grip(rng, 4)
    delta = 0.004
    x = perturbed_plane(target, gripper, axis, delta)
    starts = around(axis, np.append(0.0, rng.uniform(0, 1, 7)), rng)
    ends = np.asarray(descend_eq_9(target, gripper, delta, starts))
    for points, end, mine in zip(gripper, ends, x, strict=True):
        if plane_clearance(target, points, axis) >= delta:
            continue
        solves = np.abs(plane_clearance(target, points[None], end) - delta) < 1e-6
        assert (angle(end[solves], axis) > angle(mine, axis) - 1e-4).all()


@settings(deadline=None, max_examples=40)
@given(SEEDS, st.floats(0.001, 0.02))
def test_proposition_2_a_plane_parts_any_two_disjoint_bodies(seed, delta):
    """Both ways, as H(x₀) > 0 > H(−x₀): somewhere between the two H is zero, and tilted planes are found."""
    rng = np.random.default_rng(seed)
    target = random_hull(rng)
    apart = directions(rng)
    gripper = random_hull(rng) + apart * (0.11 + 2 * delta)
    x0 = -apart
    assert plane_clearance(target, gripper[None], x0[None])[0] > delta
    assert plane_clearance(target, gripper[None], -x0[None])[0] < delta
    # From any nominal direction nearer than 90° to x₀ there is a way to it, so a solution within 90° exists.
    axis = around(x0, rng.uniform(0.1, 1.5, 1), rng)[0]
    x = perturbed_plane(target, gripper[None], axis, delta)
    assert plane_clearance(target, gripper[None], x)[0] >= delta - 1e-9
    assert angle(x[0], axis) <= angle(x0, axis) + 1e-9


@settings(deadline=None, max_examples=40)
@given(SEEDS, st.floats(0, 1))
def test_relaxed_release_stays_in_the_cone_and_tells_the_truth(seed, half_angle):
    rng = np.random.default_rng(seed)
    target, axis, gripper = a_grip(rng)
    cone, delta = ReleaseCone(axis, half_angle), 0.004
    x, clear = relaxed_release(cone, target, gripper, delta)
    assert (angle(x, axis) <= half_angle + 1e-9).all()
    clearance = plane_clearance(target, gripper, x)
    np.testing.assert_array_equal(clear, clearance >= delta - 1e-9)
    # Where it says no, no direction of the cone does.
    tried = around(axis, half_angle * np.sqrt(rng.uniform(size=500)), rng)
    for points in gripper[~clear]:
        assert (plane_clearance(target, points[None], tried) < delta).all()


def test_a_finger_under_a_lying_box_is_cleared_by_tilting_it_over_its_farthest_corner():
    """In closed form: for δ = 0 the tilt that lifts the point g to the level of v has sine −(v − g)·x*/‖v − g‖."""
    target = CUBE * [0.05, 0.05, 0.02]
    finger = np.array([0.055, 0.01, -0.03])
    axis = np.array([0, 0, -1.0])
    x = perturbed_plane(target, finger[None, None], axis, 0.0)
    arm = np.array([-0.05, -0.05, -0.02]) - finger
    assert angle(x[0], axis) == pytest.approx(np.arcsin(-arm @ axis / np.linalg.norm(arm)))
    assert x[0] @ arm == pytest.approx(0, abs=1e-12)


# --- settling ---------------------------------------------------------------------------------------------------------


def exact_clearance(piece, points):
    """coal's signed distance of two hulls."""
    hulls = []
    for vertices in (piece, points):
        cloud = coal.StdVec_Vec3s()
        cloud.extend(list(vertices))
        hulls.append(coal.Convex.convexHull(cloud, False, ""))
    still = coal.Transform3s.Identity()
    return coal.distance(hulls[0], still, hulls[1], still, coal.DistanceRequest(), coal.DistanceResult())


def apart_along_facets(piece, points):
    """The farthest that two hulls are apart along the normals of the facets of either."""
    normals = np.vstack([ConvexHull(piece).equations[:, :3], -ConvexHull(points).equations[:, :3]])
    return ((points @ normals.T).min(axis=0) - (piece @ normals.T).max(axis=0)).max()


@settings(deadline=None, max_examples=30)
@given(SEEDS)
@example(247)  # a corner far off a corner, of which the normals tell less than half
def test_settling_clearance_is_the_one_along_facets_and_no_more_than_the_exact_one(seed):
    rng = np.random.default_rng(seed)
    pieces = [random_hull(rng, 12), random_hull(rng, 8) + 0.03]
    shapes = [0.3 * random_hull(rng, 10), CUBE * [0.01, 0.005, 0.03]]
    axis = directions(rng)
    x = around(axis, rng.uniform(0.05, 1.2, 3), rng)
    turns = Rotation.random(3, rng).as_matrix()
    shifts = 0.08 * directions(rng, 3)
    bodies = [np.einsum("kij,gj->kgi", turns, shape) + shifts[:, None] for shape in shapes]
    found = settling_clearance(pieces, bodies, axis, x)
    corners = np.concatenate(pieces)
    for k in range(3):
        pivot = corners[(corners @ x[k]).argmax()]
        turn = np.cross(x[k], axis)
        turn *= angle(x[k], axis) / np.linalg.norm(turn)
        exact = along_facets = np.inf
        for step in range(1, SETTLING_STEPS + 1):
            rolled = Rotation.from_rotvec(-step / SETTLING_STEPS * turn)
            if step == SETTLING_STEPS:
                # The target rolls forth in the world, so its down direction comes to be the axis.
                np.testing.assert_allclose(rolled.inv().apply(x[k]), axis, atol=1e-9)
            moved = [pivot + rolled.apply(piece - pivot) for piece in pieces]
            pairs = [(piece, body[k]) for piece in moved for body in bodies]
            exact = min(exact, *(exact_clearance(*pair) for pair in pairs))
            along_facets = min(along_facets, *(apart_along_facets(*pair) for pair in pairs))
        assert found[k] <= exact + 1e-6
        assert found[k] == pytest.approx(along_facets, abs=1e-7)


def test_a_finger_under_the_falling_side_is_in_the_way_and_one_beside_it_is_not():
    box = CUBE * [0.03, 0.03, 0.02]
    axis = np.array([0, 0, -1.0])
    tilt = 0.6
    # Tilted about y, so that the lowest edge is the one at −x: the side at +x is going to fall.
    x = np.cos(tilt) * axis + np.sin(tilt) * np.array([-1.0, 0, 0])
    finger = CUBE * [0.005, 0.005, 0.02]
    below = finger + np.array([0.036, 0, -0.02])
    beside = finger + np.array([0, 0.0365, 0])
    bodies = [np.stack([below, beside])]
    found = settling_clearance([box], bodies, axis, np.stack([x, x]))
    assert found[0] < -0.01
    assert found[1] == pytest.approx(0.0015)
    # Without a tilt only the start counts.
    assert settling_clearance([box], [below[None]], axis, axis[None])[0] == pytest.approx(0.001)


@pytest.mark.parametrize("spot", [(0.0, 0.0), (-1.0, 0.0), (0.5, -0.9)])
def test_the_target_is_put_down_in_its_spot_within_the_area(spot):
    hull = np.random.default_rng(1).normal(size=(20, 3)) * [0.02, 0.03, 0.04]
    rotation = stable_poses(hull).rotations[0]
    area = ReleaseArea(np.array([0.5, 0.1, 0.02]), np.array([0.14, 0.12]))
    poses = resting_poses(area, hull, rotation, 8, (spot,))
    assert len(poses) == 8
    for pose in poses:
        points = rigid(pose).apply(hull)
        low, high = points.min(axis=0), points.max(axis=0)
        assert low[2] == pytest.approx(0.02)
        room = area.half_extents - 0.5 * (high - low)[:2]
        np.testing.assert_allclose(0.5 * (low + high)[:2], area.center[:2] + room * spot, atol=1e-12)
    large = [*resting_poses(area, 4 * hull, rotation, 8, (spot,))]
    assert len(large) < 8
