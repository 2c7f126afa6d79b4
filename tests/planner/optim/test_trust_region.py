"""Parts of the trust region: the subproblem, acceptance of steps, and the radius."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp_planner.optim.trust_region import judge, propose, truncated_cg

seeds = st.integers(0, 2**31 - 1)


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_truncated_cg_stays_inside_and_beats_the_cauchy_point(seed):
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(5, 5))
    hessian, gradient, radius = jnp.asarray(a + a.T), jnp.asarray(rng.normal(size=5)), rng.uniform(0.01, 3.0)
    step, hit = jax.jit(truncated_cg)(gradient, hessian, jnp.asarray(radius))

    def model(s):
        return float(gradient @ s + 0.5 * s @ hessian @ s)

    assert np.linalg.norm(step) <= radius * (1 + 1e-9)
    lengths = np.linspace(0, radius, 400)
    cauchy = min(model(-t * gradient / jnp.linalg.norm(gradient)) for t in lengths[::8])
    assert model(step) <= cauchy + 1e-9
    if np.linalg.eigvalsh(hessian)[0] < -1e-6 and np.linalg.norm(step) < radius * (1 - 1e-6):
        assert not hit


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_a_wide_region_gives_the_newton_step_and_its_decrease(seed):
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(4, 4))
    hessian, gradient = a @ a.T + 0.5 * np.eye(4), 1e-3 * rng.normal(size=4)
    step = jax.jit(propose)(jnp.asarray(gradient), jnp.asarray(hessian), jnp.asarray(1e3))
    newton = -np.linalg.solve(hessian, gradient)
    assert not step.on_boundary
    np.testing.assert_allclose(step.tangent, newton, rtol=1e-2, atol=1e-2 * np.linalg.norm(newton))
    assert float(step.predicted) == pytest.approx(-0.5 * gradient @ newton, rel=1e-4)


@pytest.mark.parametrize(
    ("after", "accepted", "radius"),
    [(-1.0, True, 2.0), (-0.5, True, 1.0), (-0.1, True, 0.25), (0.5, False, 0.25), (np.nan, False, 0.25)],
    ids=["as predicted", "half of it", "a tenth", "an increase", "not finite"],
)
def test_radius_and_acceptance_follow_the_ratio_of_decreases(after, accepted, radius):
    """A step of length 1 to the boundary that is predicted to lower the value 0 by 1."""
    step = propose(jnp.array([1.5, 0.0]), jnp.eye(2), jnp.asarray(1.0))
    assert step.on_boundary
    assert float(step.predicted) == pytest.approx(1.0)
    good, following = judge(step, jnp.asarray(0.0), jnp.asarray(after), jnp.asarray(1.0), 10.0)
    assert bool(good) == accepted
    assert float(following) == pytest.approx(radius)
