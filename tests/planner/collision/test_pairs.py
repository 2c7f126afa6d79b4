"""Bounds of pairs against their distances, and derivatives against finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from regrasp_planner.collision.clearance import configuration_clearance
from regrasp_planner.collision.model import body_frames
from regrasp_planner.collision.pairs import pair_bounds, pair_clearances

over_configurations = (None, 0, 0, None)
frames = jax.jit(jax.vmap(body_frames, in_axes=over_configurations[:3]))
clearances = jax.jit(jax.vmap(pair_clearances, in_axes=over_configurations))


def test_bounds_are_lower_bounds_and_culling_loses_nothing(model, random_configurations):
    q = random_configurations(4, seed=1)
    theta = np.full(4, 0.02)
    value = clearances(model.arrays, jnp.asarray(q), jnp.asarray(theta), jnp.arange(len(model.pairs)))
    value = np.where(model.arrays.valid, value, np.inf)
    poses = frames(model.arrays, jnp.asarray(q), jnp.asarray(theta))
    bounds = jax.jit(pair_bounds)(model.arrays, poses)
    # A DSF may lie below the hull by its sharpness, so below the hull's bound too.
    assert np.all(np.asarray(bounds)[:, model.arrays.valid] <= value[:, model.arrays.valid] + 6e-3)
    assert np.isinf(bounds[:, ~np.asarray(model.arrays.valid)]).all()
    found = configuration_clearance(model, q, theta, cap=10.0)
    np.testing.assert_allclose(found.value, value.min(1), atol=1e-6)
    np.testing.assert_array_equal(found.pair, value.argmin(1))


@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])
def test_derivatives_match_finite_differences(model, random_configurations, derivative):
    q = random_configurations(4, seed=3)
    theta, pairs = jnp.full(4, 0.02), jnp.arange(len(model.pairs))
    slope = jax.jit(jax.vmap(derivative(pair_clearances, argnums=1), in_axes=over_configurations))
    direction, h = np.random.default_rng(0).normal(size=7), 1e-6
    ahead = clearances(model.arrays, jnp.asarray(q + h * direction), theta, pairs)
    behind = clearances(model.arrays, jnp.asarray(q - h * direction), theta, pairs)
    apart = np.asarray(clearances(model.arrays, jnp.asarray(q), theta, pairs)) > 0
    assert apart.sum() > 20
    difference = np.asarray(ahead - behind) / (2 * h)
    found = slope(model.arrays, jnp.asarray(q), theta, pairs) @ direction
    np.testing.assert_allclose(found[apart], difference[apart], atol=1e-4)
