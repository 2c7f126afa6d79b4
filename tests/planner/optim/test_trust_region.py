"""Riemannian trust region against closed forms, pymanopt and scipy."""

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pymanopt
import pytest
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp_planner.optim import SE3, Euclidean, Product, Sphere, Status, truncated_cg, trust_region

both_models = pytest.mark.parametrize("hessian", ["exact", "bfgs"])
seeds = st.integers(0, 2**31 - 1)


def spherical_rosenbrock(x, params):
    return 20.0 * (x[1] - x[0] ** 2) ** 2 + (params - x[0]) ** 2 + x[2]


def from_random_starts(objective, manifold, count, seed=0, params=(), **options):
    starts = jax.vmap(manifold.random_point)(jax.random.split(jax.random.key(seed), count))
    solve = jax.jit(jax.vmap(lambda x: trust_region(objective, x, manifold, params=params, **options)))
    return solve(starts)


@both_models
def test_rosenbrock_on_the_sphere_agrees_with_pymanopt(hessian):
    sphere = pymanopt.manifolds.Sphere(3)
    gradient = jax.jit(jax.grad(spherical_rosenbrock))

    @pymanopt.function.numpy(sphere)
    def cost(x):
        return float(spherical_rosenbrock(x, 1.0))

    @pymanopt.function.numpy(sphere)
    def euclidean_gradient(x):
        return np.asarray(gradient(x, 1.0))

    problem = pymanopt.Problem(sphere, cost, euclidean_gradient=euclidean_gradient)
    oracle = pymanopt.optimizers.ConjugateGradient(verbosity=0, min_gradient_norm=1e-9, max_iterations=2000)
    costs = [oracle.run(problem, initial_point=np.eye(3)[i]).cost for i in range(3)]

    result = from_random_starts(spherical_rosenbrock, Sphere(), 16, params=1.0, hessian=hessian)
    assert np.all(result.status == Status.CONVERGED)
    assert float(result.value.min()) == pytest.approx(min(costs), abs=1e-9)
    np.testing.assert_allclose(np.linalg.norm(result.point, axis=-1), 1.0, atol=1e-14)


@both_models
@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_procrustes_on_se3(hessian, seed):
    rng = np.random.default_rng(seed)
    cloud = rng.normal(size=(12, 3)) * [1.0, 0.7, 0.4]
    truth = SE3().random_point(jax.random.key(seed))
    seen = jax.vmap(lambda x: jaxlie.SE3(truth) @ x)(cloud) + 0.01 * rng.normal(size=cloud.shape)

    def misfit(pose, data):
        moved = jax.vmap(lambda x: jaxlie.SE3(pose) @ x)(data[0])
        return 0.5 * jnp.mean(jnp.sum((moved - data[1]) ** 2, axis=1))

    result = procrustes_solver(misfit, hessian)(jnp.asarray(cloud), seen)
    best = int(np.argmin(result.value))
    # Kabsch's closed form.
    a, b = cloud - cloud.mean(0), np.asarray(seen) - np.asarray(seen).mean(0)
    u, _, vt = np.linalg.svd(a.T @ b)
    rotation = vt.T @ np.diag([1, 1, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    pose = jaxlie.SE3(result.point[best])
    np.testing.assert_allclose(pose.rotation().as_matrix(), rotation, atol=1e-6)
    np.testing.assert_allclose(pose.translation(), np.asarray(seen).mean(0) - rotation @ cloud.mean(0), atol=1e-6)
    assert int(result.evaluations[best]) < 60


_solvers = {}


def procrustes_solver(misfit, hessian):
    """One compiled solver per model, from the same eight starts."""
    if hessian not in _solvers:
        starts = jax.vmap(SE3().random_point)(jax.random.split(jax.random.key(1), 8))
        _solvers[hessian] = jax.jit(
            lambda cloud, seen: jax.vmap(
                lambda x: trust_region(misfit, x, SE3(), params=(cloud, seen), hessian=hessian, tolerance=1e-9)
            )(starts)
        )
    return _solvers[hessian]


@both_models
def test_euclidean_rosenbrock_needs_no_more_evaluations_than_scipy_bfgs(hessian):
    def rosenbrock(x, params):
        return jnp.sum(100.0 * (x[1:] - x[:-1] ** 2) ** 2 + (1.0 - x[:-1]) ** 2)

    start = jnp.array([-1.2, 1.0, -1.2, 1.0])
    result = trust_region(rosenbrock, start, Euclidean(4), hessian=hessian, max_radius=10.0)
    grad = jax.jit(jax.grad(rosenbrock))
    oracle = scipy.optimize.minimize(lambda x: float(rosenbrock(x, ())), start, jac=lambda x: np.asarray(grad(x, ())))
    assert int(result.status) == Status.CONVERGED
    np.testing.assert_allclose(result.point, oracle.x if oracle.fun < 1e-8 else 1.0, atol=1e-5)
    assert int(result.evaluations) <= 1.5 * oracle.nfev


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_product_minimum_is_the_factors_minima(seed):
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=3)
    center = jnp.asarray(rng.normal(size=2))
    goal = SE3().random_point(jax.random.key(seed))

    result = product_solver(jnp.asarray(direction), center, goal)
    x, pose, y = result.point
    assert int(result.status) in (Status.CONVERGED, Status.STALLED)
    np.testing.assert_allclose(x, -direction / np.linalg.norm(direction), atol=1e-6)
    np.testing.assert_allclose(jaxlie.SE3(pose).as_matrix(), jaxlie.SE3(goal).as_matrix(), atol=1e-6)
    np.testing.assert_allclose(y, center, atol=1e-6)


@jax.jit
def product_solver(direction, center, goal):
    manifold = Product((Sphere(), SE3(), Euclidean(2)))

    def objective(point, params):
        x, pose, y = point
        direction, center, goal = params
        apart = jaxlie.SE3(pose).as_matrix() - jaxlie.SE3(goal).as_matrix()
        return x @ direction + jnp.sum(apart**2) + jnp.sum((y - center) ** 2)

    # A start that is not antipodal to the goal, where the chordal distance has saddle points.
    near = SE3().retract(goal, jnp.array([0.5, -0.3, 0.2, 0.9, -0.8, 0.4]))
    start = (jnp.array([0.6, 0.0, 0.8]), near, jnp.zeros(2))
    return trust_region(objective, start, manifold, params=(direction, center, goal))


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


def test_statuses():
    def bowl(x, params):
        return jnp.sum((x - params) ** 2)

    start = jnp.zeros(2)
    assert trust_region(bowl, start, Euclidean(2), params=1e3, max_evaluations=5).status == Status.BUDGET
    assert trust_region(bowl, start, Euclidean(2), params=0.0).status == Status.CONVERGED
    assert trust_region(bowl, start, Euclidean(2), params=jnp.nan).status == Status.NOT_FINITE
    # A wall of NaN beside the start: steps into it are refused, the solver still reaches the minimum.
    result = trust_region(lambda x, p: jnp.sum(x**2) + 0.0 * jnp.log(x[0] + 0.1), jnp.ones(2), Euclidean(2))
    assert result.status == Status.CONVERGED


def test_objective_is_traced_once():
    traces = []

    def objective(x, params):
        traces.append(1)
        return jnp.sum(x**2)

    jax.jit(lambda x: trust_region(objective, x, Euclidean(3)))(jnp.ones(3))
    assert len(traces) == 1


def test_same_inputs_give_identical_results():
    one = from_random_starts(spherical_rosenbrock, Sphere(), 4, seed=3, params=0.7)
    two = from_random_starts(spherical_rosenbrock, Sphere(), 4, seed=3, params=0.7)
    jax.tree.map(np.testing.assert_array_equal, one, two)
