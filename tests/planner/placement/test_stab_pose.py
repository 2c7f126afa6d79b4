"""Stable poses: against trimesh, the exact hull, steepest descent and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from regrasp_planner import ConvexBody, GeometryError, stable_poses
from regrasp_planner.geometry import facets, mass_properties, qhull
from regrasp_planner.geometry.support import support_point, support_value

CUBE = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)


def prism(sides, radius, height):
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(sides)], axis=1)
    lift = np.array([0, 0, height / 2])
    return np.concatenate([ring + lift, ring - lift])


def random_hull(rng, count):
    vertices = rng.normal(size=(count, 3))
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True) * rng.uniform(0.4, 1, 3) * 0.05


def landing(vertices):
    """trimesh's directions that point down, and their probabilities."""
    hull = qhull(vertices)
    mesh = trimesh.Trimesh(hull.points, hull.simplices)
    mesh.fix_normals()
    transforms, probabilities = mesh.compute_stable_poses(sigma=0, n_samples=1, threshold=0)
    return -transforms[:, 2, :3], probabilities


def foot_margin(vertices, direction):
    """Margin of the centre of mass's foot within the facet under ``direction``, from a 2-D hull of its corners."""
    center = mass_properties(vertices).center
    heights = (vertices - center) @ direction
    corners = (vertices - center)[heights > heights.max() - 1e-9]
    plane = np.linalg.svd(direction[None])[2][1:]
    flat = corners @ plane.T
    around = flat.mean(axis=0)
    order = np.argsort(np.arctan2(*(flat - around).T[::-1]))
    ring = flat[order]
    along = np.roll(ring, -1, axis=0) - ring
    inward = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    return (-ring * inward).sum(axis=1).min()


@pytest.mark.parametrize("count", [12, 20, 60, 200])
def test_finds_the_landing_probability_of_trimesh_and_invents_none(count):
    rng = np.random.default_rng(count)
    shares = []
    for _ in range(25):
        vertices = random_hull(rng, count)
        directions, probabilities = landing(vertices)
        poses = stable_poses(vertices)
        near = (directions @ poses.directions.T).max(axis=1) > np.cos(np.deg2rad(5))
        shares.append(probabilities[near].sum())
        for direction, margin in zip(poses.directions, poses.margin, strict=True):
            assert foot_margin(vertices, direction) == pytest.approx(margin, rel=1e-6, abs=1e-9)
            assert margin > 0
    assert min(shares) > 0.995


@pytest.mark.parametrize(
    ("vertices", "number"),
    [(CUBE * [0.03, 0.02, 0.01], 6), (CUBE * 0.03, 6), (prism(24, 0.03, 0.1), 26), (prism(24, 0.04, 0.03), 26)],
)
def test_boxes_and_prisms_stand_on_every_face(vertices, number):
    poses = stable_poses(vertices)
    assert len(poses) == number
    assert poses.probability.sum() == pytest.approx(1)
    assert (poses.probability > 0).all()
    assert (poses.stability > 0).all()


def test_box_figures_are_exact():
    half = np.array([0.03, 0.02, 0.01])
    poses = stable_poses(CUBE * half)
    for direction, height, margin, barrier in zip(
        poses.directions, poses.height, poses.margin, poses.barrier, strict=True
    ):
        axis = int(np.abs(direction).argmax())
        sides = np.delete(half, axis)
        assert height == pytest.approx(half[axis])
        assert margin == pytest.approx(sides.min())
        assert barrier == pytest.approx(np.hypot(half[axis], sides.min()) - half[axis])
    assert np.abs(poses.directions[0]).argmax() == 2
    assert (np.diff(poses.stability) <= 1e-12).all()


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**31))
def test_rotations_bring_the_direction_down_and_the_set_turns_with_the_object(seed):
    rng = np.random.default_rng(seed)
    vertices = random_hull(rng, 14)
    poses = stable_poses(vertices)
    np.testing.assert_allclose(poses.rotations[:, 2], -poses.directions, atol=1e-12)
    np.testing.assert_allclose(
        poses.rotations @ poses.rotations.transpose(0, 2, 1), np.eye(3)[None].repeat(len(poses), 0), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(poses.rotations), 1)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    turned = stable_poses(vertices @ turn.T + rng.normal(size=3))
    assert len(turned) == len(poses)
    assert ((turned.directions @ turn @ poses.directions.T).max(axis=1) > 1 - 1e-9).all()


def steepest_descent(offsets, starts, steps=1200, stride=0.005):
    """Starts moved down the exact support function in short strides."""
    x = starts.copy()
    for k in range(steps):
        support = offsets[(x @ offsets.T).argmax(axis=1)]
        slope = support - (support * x).sum(axis=1, keepdims=True) * x
        x -= stride * (1 - k / steps) * slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12)
        x /= np.linalg.norm(x, axis=1, keepdims=True)
    return x


def test_basins_follow_steepest_descent_on_the_exact_hull():
    rng = np.random.default_rng(4)
    agreement = []
    for _ in range(6):
        vertices = rng.uniform(-1, 1, size=(20, 3)) * [0.02, 0.03, 0.04]
        poses = stable_poses(vertices)
        hull = qhull(vertices)
        center = mass_properties(vertices).center
        ends = steepest_descent(hull.points[hull.vertices] - center, poses.starts)
        faces = facets(hull, center)
        facet = (ends @ faces.normals.T).argmax(axis=1)
        for _ in faces.normals:
            facet = faces.topples_to[facet]
        agreement.append(((faces.normals[facet] * poses.directions[poses.basin]).sum(axis=1) > np.cos(0.01)).mean())
        assert poses.probability == pytest.approx(np.bincount(poses.basin, minlength=len(poses)) / len(poses.starts))
    assert np.mean(agreement) > 0.95


def a_dsf(rng, sharpness):
    """A DSF about its centre of mass, the inertia of its solid hull, and a direction."""
    vertices = random_hull(rng, 20)
    mass = mass_properties(vertices)
    x = rng.normal(size=3)
    body = ConvexBody.from_vertices(vertices - mass.center, sharpness=sharpness)
    return body, mass.inertia, x / np.linalg.norm(x)


@jax.jit
@jax.grad
def riemannian_gradient(x, body):
    """Gradient of h on the sphere, by automatic differentiation along the tangent plane."""
    return support_value(body, x / jnp.linalg.norm(x))


def settling_step(body, x, inertia, dt):
    """The paper's x⁺ of eq. (8) after ``dt`` from rest, with Mg = 1: ω = Δt I⁻¹(s × x), x⁺ = exp([ω Δt]×) x."""
    spin = dt * np.linalg.solve(inertia, np.cross(support_point(body, x), x))
    return Rotation.from_rotvec(spin * dt).apply(x)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**31), st.sampled_from([16, 128, 1026]))
def test_proposition_1_a_step_of_eq_8_is_parallel_to_the_gradient(seed, sharpness):
    rng = np.random.default_rng(seed)
    body, _, x = a_dsf(rng, sharpness)
    gradient = np.asarray(riemannian_gradient(x, body))
    support = np.asarray(support_point(body, x))
    np.testing.assert_allclose(gradient, support - (support @ x) * x, atol=1e-12)
    moment = 1e-3
    step = settling_step(body, x, moment * np.eye(3), 1e-4) - x
    np.testing.assert_allclose(step, -(1e-8 / moment) * gradient, rtol=1e-4, atol=1e-13)
    assert step @ gradient == pytest.approx(-np.linalg.norm(step) * np.linalg.norm(gradient), rel=1e-8)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**31))
def test_proposition_1_for_any_inertia_in_the_metric_of_the_inertia(seed):
    """Δx = −Δt² [x]ᵀ I⁻¹ [x] grad h: downhill, and zero where the gradient is, parallel only for isotropic I."""
    rng = np.random.default_rng(seed)
    body, inertia, x = a_dsf(rng, 128)
    gradient = np.asarray(riemannian_gradient(x, body))
    step = settling_step(body, x, inertia, 1e-4) - x
    across = np.cross(np.eye(3), x)
    np.testing.assert_allclose(
        step, -1e-8 * across @ np.linalg.solve(inertia, across.T @ gradient), rtol=1e-3, atol=1e-13
    )
    assert step @ gradient < 0


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**31))
def test_stable_poses_are_equilibria_of_eq_8(seed):
    """The foot of the centre of mass is a point of the supporting facet, and from there s × x vanishes."""
    poses = stable_poses(random_hull(np.random.default_rng(seed), 20))
    foot = poses.height[:, None] * poses.directions
    np.testing.assert_allclose(np.cross(foot, poses.directions), 0, atol=1e-15)
    np.testing.assert_allclose((poses.corners @ poses.directions.T).max(axis=0), poses.height, rtol=1e-9)
    assert (poses.margin > 0).all()


def test_a_heavy_bottom_makes_a_roly_poly():
    tall = prism(24, 0.02, 0.2)
    low = stable_poses(tall, center_of_mass=np.array([0, 0, -0.095]))
    upright = int((low.directions @ [0, 0, -1]).argmax())
    assert low.probability[upright] > stable_poses(tall).probability.max() + 0.2
    assert low.barrier[upright] == pytest.approx(np.hypot(0.02 * np.cos(np.pi / 24), 0.005) - 0.005)


def test_min_margin_leaves_out_shaky_poses():
    poses = stable_poses(prism(24, 0.03, 0.1), min_margin=0.005)
    assert len(poses) == 2
    assert np.isin(poses.basin, [-1, 0, 1]).all()


@pytest.mark.parametrize(
    ("vertices", "center", "told"),
    [
        (np.full((8, 3), np.nan), None, "not finite"),
        (np.eye(3), None, "at least 4"),
        (CUBE * [1, 1, 0], None, "zero volume"),
        (CUBE, [2, 0, 0], "outside"),
        (CUBE, [np.nan, 0, 0], "centre of mass"),
        (CUBE[:, :2], None, "shape"),
    ],
)
def test_unusable_input_is_refused_by_name(vertices, center, told):
    with pytest.raises(GeometryError, match=told):
        stable_poses(vertices, center)
