"""Manifolds: retractions stay on them, gradients match finite differences, transports are isometries."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp_planner.optim import SE3, Euclidean, Product, Sphere
from regrasp_planner.optim.manifold import tangent_basis

MANIFOLDS = {
    "sphere": Sphere(),
    "se3": SE3(length=0.2),
    "euclidean": Euclidean(4),
    "product": Product((SE3(length=0.1), Sphere(), Euclidean(2))),
}
seeds = st.integers(0, 2**31 - 1)
on_every_manifold = pytest.mark.parametrize("manifold", MANIFOLDS.values(), ids=MANIFOLDS.keys())


@lru_cache
def along(manifold):
    """Compiled t ↦ f(retract(point, t·direction)) with gradient and Hessian at 0."""

    def value(point, tangent):
        return smooth_function(manifold.retract(point, tangent))

    return tuple(jax.jit(f) for f in (value, jax.grad(value, argnums=1), jax.hessian(value, argnums=1)))


def smooth_function(point):
    """A function of any point that is nowhere symmetric."""
    flat = jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(point)])
    weights = jnp.sin(1.0 + 1.7 * jnp.arange(flat.size))
    return jnp.sin(flat @ weights) + 0.3 * (flat**2) @ jnp.cos(weights)


def random_tangent(manifold, seed, scale=1.0):
    return scale * jnp.asarray(np.random.default_rng(seed).normal(size=manifold.dim))


@on_every_manifold
@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_gradient_matches_finite_differences(manifold, seed):
    point = manifold.random_point(jax.random.key(seed))
    direction = random_tangent(manifold, seed)

    value, gradient_of, _ = along(manifold)
    h = 1e-5
    slope = (value(point, h * direction) - value(point, -h * direction)) / (2 * h)
    gradient = gradient_of(point, 0 * direction)
    assert gradient @ direction == pytest.approx(float(slope), rel=1e-6, abs=1e-7)


@on_every_manifold
@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_second_derivative_matches_finite_differences(manifold, seed):
    point = manifold.random_point(jax.random.key(seed))
    direction = random_tangent(manifold, seed)

    value, _, hessian_of = along(manifold)
    h = 1e-3
    bend = (value(point, h * direction) - 2 * value(point, 0 * direction) + value(point, -h * direction)) / h**2
    hessian = hessian_of(point, 0 * direction)
    scale = 1.0 + float(direction @ direction) ** 2
    assert abs(direction @ hessian @ direction - bend) < 2e-5 * scale


@on_every_manifold
@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_transport_is_orthogonal_and_continuous(manifold, seed):
    point = manifold.random_point(jax.random.key(seed))
    tangent = random_tangent(manifold, seed, 0.3)
    matrix = manifold.transport(point, tangent, manifold.retract(point, tangent))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(manifold.dim), atol=1e-12)
    stay = manifold.transport(point, 0 * tangent, manifold.retract(point, 0 * tangent))
    np.testing.assert_allclose(stay, np.eye(manifold.dim), atol=1e-7)


@settings(max_examples=30, deadline=None)
@given(seed=seeds, scale=st.sampled_from([0.0, 1e-9, 1e-4, 1e-2, 0.5, 2.5]))
def test_se3_retraction_is_the_group_exponential(seed, scale):
    manifold = SE3(length=0.3)
    point = manifold.random_point(jax.random.key(seed))
    tangent = random_tangent(manifold, seed, scale)
    twist = tangent.at[:3].multiply(manifold.length)
    expected = (jaxlie.SE3(point) @ jaxlie.SE3.exp(twist)).as_matrix()
    np.testing.assert_allclose(jaxlie.SE3(manifold.retract(point, tangent)).as_matrix(), expected, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_sphere_transport_carries_the_velocity_of_the_geodesic(seed):
    sphere = Sphere()
    x = sphere.random_point(jax.random.key(seed))
    v = random_tangent(sphere, seed, 0.5)
    velocity = jax.jvp(lambda t: sphere.retract(x, t * v), (1.0,), (1.0,))[1]
    y = sphere.retract(x, v)
    assert np.linalg.norm(y) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(tangent_basis(y) @ (sphere.transport(x, v, y) @ v), velocity, atol=1e-10)


@pytest.mark.parametrize("x", [[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0], [0, -1.0, 0]])
def test_tangent_basis_at_the_poles(x):
    basis = np.asarray(tangent_basis(jnp.array(x)))
    np.testing.assert_allclose(basis.T @ basis, np.eye(2), atol=1e-14)
    np.testing.assert_allclose(basis.T @ np.array(x), 0, atol=1e-14)
