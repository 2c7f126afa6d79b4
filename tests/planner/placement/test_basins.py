"""Cones of release directions: within the basins, and no higher than the object may fall."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp_planner import stable_poses
from regrasp_planner.geometry import facets, mass_properties, qhull
from regrasp_planner.placement.basins import (
    DROP,
    ENERGY,
    MARGIN,
    WIDEST,
    ReleaseCone,
    alpha_shape_angles,
    basin_angles,
    energy_angles,
    project,
    release_cones,
)
from regrasp_planner.placement.stab_pose import fibonacci_sphere

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


def falls_onto(vertices, x):
    """Normal of the facet that the ray along each x pierces, after toppling from it."""
    hull = qhull(vertices)
    faces = facets(hull, mass_properties(vertices).center)
    facet = (x @ faces.normals.T / faces.heights).argmax(axis=1)
    for _ in faces.normals:
        facet = faces.topples_to[facet]
    return faces.normals[facet]


def angle(a, b):
    return 2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))


@settings(deadline=None, max_examples=40)
@given(SEEDS)
def test_directions_within_the_rim_fall_into_the_pose_and_just_beyond_its_nearest_point_they_do_not(seed):
    rng = np.random.default_rng(seed)
    vertices = random_hull(rng)
    poses = stable_poses(vertices)
    for axis, reach in zip(poses.directions, basin_angles(poses), strict=True):
        inside = around(axis, reach * 0.999 * np.sqrt(rng.uniform(size=200)), rng)
        np.testing.assert_allclose(falls_onto(vertices, inside), np.broadcast_to(axis, inside.shape), atol=1e-9)
        beyond = around(axis, np.full(4000, 1.02 * reach + 0.01), rng)
        assert (angle(falls_onto(vertices, beyond), axis) > 1e-6).any()


@settings(deadline=None, max_examples=40)
@given(SEEDS)
def test_cones_keep_to_basin_and_energy(seed):
    rng = np.random.default_rng(seed)
    poses = stable_poses(random_hull(rng))
    cones = release_cones(poses)
    assert len(cones) == len(poses)
    unlimited = energy_angles(poses, DROP, ENERGY) == np.pi
    for k, (cone, reach) in enumerate(zip(cones, basin_angles(poses), strict=True)):
        np.testing.assert_array_equal(cone.axis, poses.directions[k])
        assert 0 <= cone.half_angle <= max(0, min(reach - MARGIN, WIDEST))
        if cone.half_angle > 0 and not unlimited[k]:
            x = around(cone.axis, np.append(cone.half_angle * np.sqrt(rng.uniform(size=300)), cone.half_angle), rng)
            assert (x @ poses.corners.T).max() + DROP <= poses.height[k] + ENERGY * poses.barrier[k] + 1e-12


def test_the_cone_of_a_box_reaches_to_its_nearest_edge():
    half = np.array([0.03, 0.02, 0.01])
    poses = stable_poses(CUBE * half)
    for direction, reach in zip(poses.directions, basin_angles(poses), strict=True):
        axis = int(np.abs(direction).argmax())
        assert reach == pytest.approx(np.arctan(np.delete(half, axis).min() / half[axis]))
    flat = release_cones(poses)[0]
    assert flat.half_angle == pytest.approx(np.arctan(2) - MARGIN)


def test_what_would_roll_on_gets_no_cone():
    ball = fibonacci_sphere(60) * 0.03
    poses = stable_poses(ball)
    assert (basin_angles(poses) > 0.1).any()
    low = poses.barrier < DROP / ENERGY
    assert low.sum() > 10
    cones = release_cones(poses)
    assert all(cones[k].half_angle == 0 for k in np.flatnonzero(low))
    # The same ball a hundred times larger does not mind falling 2 mm.
    assert any(cone.half_angle > 0 for cone in release_cones(stable_poses(100 * ball)))


def test_energy_lets_go_of_a_box_on_edge_less_far_than_its_basin():
    poses = stable_poses(CUBE * [0.024, 0.0465, 0.088])
    on_edge = int((poses.directions @ [0, -1, 0]).argmax())
    rim = np.arctan(0.024 / 0.0465)
    cone = release_cones(poses)[on_edge]
    assert 0.1 < cone.half_angle < rim - MARGIN - 0.01
    assert release_cones(poses, energy=np.inf)[on_edge].half_angle == pytest.approx(rim - MARGIN)
    assert release_cones(poses, drop=0.05)[on_edge].half_angle == 0


def test_a_roly_poly_has_no_rim():
    poses = stable_poses(fibonacci_sphere(200) * 0.03, center_of_mass=np.array([0, 0, -0.02]))
    assert len(poses) == 1
    np.testing.assert_array_equal(basin_angles(poses), [np.pi])
    assert release_cones(poses)[0].half_angle == WIDEST


def test_rims_towards_poses_that_were_left_out_count():
    shaky = stable_poses(CUBE * [0.03, 0.02, 0.01])
    firm = stable_poses(CUBE * [0.03, 0.02, 0.01], min_margin=0.015)
    assert len(firm) == 2
    np.testing.assert_allclose(basin_angles(firm), basin_angles(shaky)[:2])


def test_alpha_shapes_of_many_starts_come_to_the_exact_cone():
    poses = stable_poses(CUBE * [0.03, 0.025, 0.02], starts=4096)
    exact, sampled = basin_angles(poses), alpha_shape_angles(poses)
    # The hull of samples is inside of what they are samples of, by their spacing; and starts on a ridge go either way.
    assert (sampled < exact + 0.03).all()
    assert (sampled > exact - 0.12).all()
    few = alpha_shape_angles(stable_poses(CUBE * [0.03, 0.025, 0.02]))
    assert (few < sampled + 0.02).all()


@settings(deadline=None, max_examples=60)
@given(SEEDS, st.floats(0, 1.39))
def test_projection_goes_to_the_nearest_direction_of_the_cone_and_stays_there(seed, half_angle):
    rng = np.random.default_rng(seed)
    axis = directions(rng)
    cone = ReleaseCone(axis, half_angle)
    x = np.concatenate([directions(rng, 20), around(axis, rng.uniform(0, 0.1, 20), rng), axis[None], -axis[None]])
    projected = project(cone, x)
    np.testing.assert_allclose(np.linalg.norm(projected, axis=1), 1, atol=1e-12)
    assert (angle(projected, axis) <= half_angle + 1e-9).all()
    np.testing.assert_allclose(project(cone, projected), projected, atol=1e-9)
    inside = angle(x, axis) <= half_angle
    np.testing.assert_array_equal(projected[inside], x[inside])
    np.testing.assert_allclose(angle(projected, x)[~inside], (angle(x, axis) - half_angle)[~inside], atol=1e-7)
    np.testing.assert_allclose(project(cone, x[3]), projected[3], atol=1e-15)
