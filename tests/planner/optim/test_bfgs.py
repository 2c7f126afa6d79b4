"""BFGS model: secant equation, positive definiteness, recovery of a quadratic."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp_planner.optim.bfgs import bfgs_update

seeds = st.integers(0, 2**31 - 1)
update = jax.jit(bfgs_update)


def positive(rng, n):
    a = rng.normal(size=(n, n))
    return a @ a.T + 0.1 * np.eye(n)


@settings(max_examples=30, deadline=None)
@given(seed=seeds, n=st.integers(1, 6))
def test_secant_equation_where_curvature_is_positive(seed, n):
    rng = np.random.default_rng(seed)
    model, true = positive(rng, n), 3 * positive(rng, n)
    step = rng.normal(size=n)
    change = true @ step
    updated = np.asarray(update(jnp.asarray(model), jnp.asarray(step), jnp.asarray(change), damping=0.0))
    np.testing.assert_allclose(updated @ step, change, rtol=1e-7, atol=1e-8 * np.linalg.norm(change))


@settings(max_examples=50, deadline=None)
@given(seed=seeds, n=st.integers(1, 6))
def test_stays_positive_definite_whatever_it_sees(seed, n):
    rng = np.random.default_rng(seed)
    model = positive(rng, n)
    for scale in (1.0, -5.0, 1e-3):
        model = np.asarray(update(jnp.asarray(model), rng.normal(size=n), scale * rng.normal(size=n)))
    np.testing.assert_allclose(model, model.T)
    assert np.linalg.eigvalsh(model)[0] > 0


def test_conjugate_steps_recover_a_quadratic():
    rng = np.random.default_rng(0)
    true = positive(rng, 4)
    values, vectors = np.linalg.eigh(true)
    model = jnp.eye(4)
    for value, vector in zip(values, vectors.T, strict=True):
        model = update(model, vector, value * vector, damping=0.0)
    np.testing.assert_allclose(model, true, atol=1e-9)


def test_unusable_pairs_change_nothing():
    model = jnp.diag(jnp.array([1.0, 2.0]))
    np.testing.assert_array_equal(bfgs_update(model, jnp.zeros(2), jnp.ones(2)), model)
    np.testing.assert_array_equal(bfgs_update(model, jnp.ones(2), jnp.array([jnp.nan, 1.0])), model)
