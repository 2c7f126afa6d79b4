"""Support functions of convex bodies: derivatives, bounds, construction, errors."""

import itertools

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp_planner import ConvexBody, GeometryError
from regrasp_planner.geometry import exact_support_value, support_hessian, support_point, support_value

SEEDS = st.integers(0, 2**31)
SHARPNESS = st.sampled_from([3, 8, 20, 32, 64, 128, 512, 1500])

value, point, hessian = jax.jit(support_value), jax.jit(support_point), jax.jit(support_hessian)
exact = jax.jit(exact_support_value)


def random_body(seed, sharpness=32, radius=0.0):
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(12, 3)) * rng.uniform(0.01, 0.05, 3) + rng.normal(size=3) * 0.05
    return ConvexBody.from_vertices(vertices, radius, sharpness).padded_to(vertices=16), rng


def direction(rng):
    x = rng.normal(size=3)
    return x / np.linalg.norm(x)


@settings(deadline=None, max_examples=60)
@given(SEEDS, SHARPNESS, st.sampled_from([0.0, 0.01]))
def test_point_and_hessian_are_derivatives_of_the_value(seed, sharpness, radius):
    body, rng = random_body(seed, sharpness, radius)
    x = direction(rng)
    # Steps in proportion to the width of a crease, 1/p; central differences of fourth order.
    step = 2e-3 / sharpness
    weights = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}
    basis = np.eye(3)
    gradient = np.array([sum(w * value(body, x + k * step * e) for k, w in weights.items()) for e in basis]) / step
    second = np.array([sum(w * point(body, x + k * step * e) for k, w in weights.items()) for e in basis]) / step
    np.testing.assert_allclose(point(body, x), gradient, rtol=1e-5, atol=1e-5 * np.abs(gradient).max())
    np.testing.assert_allclose(hessian(body, x), second, rtol=1e-5, atol=1e-5 * np.abs(second).max() + 1e-16 / step)
    np.testing.assert_allclose(jax.grad(support_value, argnums=1)(body, jnp.asarray(x)), point(body, x), atol=1e-12)


@settings(deadline=None, max_examples=60)
@given(SEEDS, SHARPNESS)
def test_value_is_homogeneous_convex_and_never_below_the_hull(seed, sharpness):
    body, rng = random_body(seed, sharpness, 0.003)
    x, y = direction(rng), direction(rng)
    assert float(value(body, 2.5 * x)) == pytest.approx(2.5 * float(value(body, x)), rel=1e-12, abs=1e-15)
    assert float(value(body, x)) == pytest.approx(float(x @ point(body, x)), rel=1e-12, abs=1e-15)
    assert value(body, x + y) <= value(body, x) + value(body, y) + 1e-15
    assert value(body, x) >= exact(body, x) - 1e-15
    np.testing.assert_allclose(hessian(body, x) @ x, 0.0, atol=1e-9 * sharpness)
    assert np.linalg.eigvalsh(hessian(body, x)).min() > -1e-9


def test_sharper_is_closer_to_the_hull():
    body, rng = random_body(5)
    x = direction(rng)
    gaps = [float(value(body.with_sharpness(p), x) - exact(body, x)) for p in (8, 32, 128, 512)]
    assert all(a >= b for a, b in itertools.pairwise(gaps))
    assert gaps[-1] < 1e-4


def test_sharpness_is_data_and_does_not_compile_again():
    body, rng = random_body(6)
    counted = jax.jit(lambda body, x: support_value(body, x))
    for p in (8, 16, 300):
        counted(body.with_sharpness(p), direction(rng))
    assert counted._cache_size() == 1


@settings(deadline=None, max_examples=20)
@given(SEEDS)
def test_thinning_out_keeps_the_hull_inside(seed):
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(400, 3))
    vertices *= 0.04 / np.linalg.norm(vertices, axis=1, keepdims=True)
    body = ConvexBody.from_vertices(vertices, max_vertices=32)
    assert len(body.hull_vertices()) <= 32
    x = rng.normal(size=(50, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    reach = exact_support_value(jax.tree.map(lambda leaf: leaf[None], body), jnp.asarray(x))
    excess = reach - (x @ vertices.T).max(axis=1)
    assert (excess >= -1e-12).all()
    assert excess.max() < 0.006


def test_primitives_contain_their_shape_and_little_more():
    rng = np.random.default_rng(0)
    pose = jaxlie.SE3.exp(jnp.asarray(rng.normal(size=6) * 0.3))
    rotation, shift = np.asarray(pose.rotation().as_matrix()), np.asarray(pose.translation())
    box = ConvexBody.box([0.04, 0.06, 0.1], pose)
    capsule = ConvexBody.capsule(0.05, 0.2, pose)
    sphere = ConvexBody.sphere(0.03, shift)
    for _ in range(50):
        x = direction(rng)
        local = rotation.T @ x
        at = shift @ x
        assert float(exact(box, x)) == pytest.approx(at + np.abs(local) @ [0.02, 0.03, 0.05], abs=1e-12)
        assert -1e-12 < float(value(capsule, x)) - (at + 0.1 * abs(local[2]) + 0.05) < 1.5e-3
        assert -1e-12 < float(value(sphere, x)) - (at + 0.03) < 1.5e-3


def test_moving_a_body_moves_its_support_function():
    body, rng = random_body(9, radius=0.01)
    pose = jaxlie.SE3.exp(jnp.asarray(rng.normal(size=6)))
    x = direction(rng)
    moved = float(pose.translation() @ x + value(body, pose.rotation().inverse() @ jnp.asarray(x)))
    assert float(value(body.transformed(pose), x)) == pytest.approx(moved, rel=1e-12)


def test_batches_stack_index_and_pad():
    small, large = ConvexBody.box([0.1, 0.1, 0.1]), random_body(3, radius=0.02)[0]
    batch = ConvexBody.stack([small, large])
    assert batch.batch_size == 2
    assert batch.vertices.shape == (2, 16, 3)
    padded = ConvexBody.concatenate([batch, batch]).padded_to(batch=8, vertices=32)
    x = jnp.asarray([0.6, 0.0, 0.8])
    assert float(support_value(padded, jnp.tile(x, (8, 1)))[1]) == pytest.approx(float(value(large, x)), rel=1e-13)
    np.testing.assert_allclose(np.sort(padded[0].hull_vertices(), axis=0), np.sort(small.hull_vertices(), axis=0))
    center, radius = large.bounding_sphere()
    assert float(radius) >= np.linalg.norm(large.hull_vertices() - np.asarray(center), axis=1).max() + 0.02 - 1e-12


@pytest.mark.parametrize(
    ("vertices", "told"),
    [
        (np.zeros((5, 2)), "shape"),
        (np.eye(3), "at least 4"),
        (np.vstack([np.eye(3), [[np.nan, 0, 0]]]), "vertex 3"),
        (np.random.default_rng(0).normal(size=(20, 3)) * [1, 1, 0], "zero volume"),
        (np.ones((6, 3)), "zero volume"),
    ],
)
def test_unusable_vertices_are_refused_by_name(vertices, told):
    with pytest.raises(GeometryError, match=told):
        ConvexBody.from_vertices(vertices)


def test_unusable_parameters_are_refused():
    cube = ConvexBody.box([1, 1, 1])
    with pytest.raises(GeometryError, match="radius"):
        ConvexBody.from_vertices(cube.hull_vertices(), radius=-1)
    with pytest.raises(GeometryError, match="sharpness"):
        cube.with_sharpness(2.5)
    with pytest.raises(GeometryError, match="box size"):
        ConvexBody.box([1, -1, 1])
    with pytest.raises(GeometryError, match="capsule radius"):
        ConvexBody.capsule(float("nan"), 1)
    with pytest.raises(GeometryError, match="at least one"):
        ConvexBody.stack([])
    with pytest.raises(GeometryError, match="more than"):
        ConvexBody.stack([cube]).padded_to(vertices=4)
