"""Manifolds: derivatives match finite differences, and the retraction of SE(3) is the group exponential."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp_planner.optim.manifold import SE3, Euclidean, Product

IDENTITY = jaxlie.SE3.identity().wxyz_xyz
MANIFOLDS = {
    "se3": (SE3(length=0.2), IDENTITY),
    "euclidean": (Euclidean(4), jnp.zeros(4)),
    "product": (Product((SE3(length=0.1), Euclidean(2))), (IDENTITY, jnp.zeros(2))),
}
seeds = st.integers(0, 2**31 - 1)


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


@pytest.mark.parametrize("space", MANIFOLDS.values(), ids=MANIFOLDS.keys())
@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_derivatives_match_finite_differences(space, seed):
    manifold, origin = space
    rng = np.random.default_rng(seed)
    point = manifold.retract(origin, 2.0 * rng.normal(size=manifold.dim))
    direction = rng.normal(size=manifold.dim)
    value, gradient_of, hessian_of = along(manifold)

    h = 1e-5
    slope = (value(point, h * direction) - value(point, -h * direction)) / (2 * h)
    assert gradient_of(point, 0 * direction) @ direction == pytest.approx(float(slope), rel=1e-6, abs=1e-7)

    h = 1e-3
    bend = (value(point, h * direction) - 2 * value(point, 0 * direction) + value(point, -h * direction)) / h**2
    scale = 1.0 + float(direction @ direction) ** 2
    assert abs(direction @ hessian_of(point, 0 * direction) @ direction - bend) < 2e-5 * scale


@settings(max_examples=30, deadline=None)
@given(seed=seeds, scale=st.sampled_from([0.0, 1e-9, 1e-4, 1e-2, 0.5, 2.5]))
def test_se3_retraction_is_the_group_exponential(seed, scale):
    manifold = SE3(length=0.3)
    point = jaxlie.SE3.sample_uniform(jax.random.key(seed)).wxyz_xyz
    tangent = scale * jnp.asarray(np.random.default_rng(seed).normal(size=6))
    twist = tangent.at[:3].multiply(manifold.length)
    expected = (jaxlie.SE3(point) @ jaxlie.SE3.exp(twist)).as_matrix()
    np.testing.assert_allclose(jaxlie.SE3(manifold.retract(point, tangent)).as_matrix(), expected, atol=1e-9)
