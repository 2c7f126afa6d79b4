"""Augmented Lagrangian on problems with known solutions, and against scipy and pymanopt."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pymanopt
import pytest
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp_planner.optim.augmented_lagrangian import Options, Stall, Status, augmented_lagrangian
from regrasp_planner.optim.manifold import SE3, Euclidean, Product

NONE = jnp.zeros(0)
seeds = st.integers(0, 2**31 - 1)


def free(objective):
    """The problem without constraints."""
    return lambda point, params: (objective(point, params), NONE, NONE)


def on_the_sphere(count, seed=0):
    """Random unit vectors (count, 3)."""
    x = jax.random.normal(jax.random.key(seed), (count, 3))
    return x / jnp.linalg.norm(x, axis=1, keepdims=True)


def rosenbrock_above(x, params):
    return 100 * (x[1] - x[0] ** 2) ** 2 + (1 - x[0]) ** 2, NONE, jnp.array([x[1] + 1.5])


def hock_schittkowski_6(x, params):
    return (1 - x[0]) ** 2, jnp.array([10 * (x[1] - x[0] ** 2)]), NONE


def hock_schittkowski_7(x, params):
    return jnp.log(1 + x[0] ** 2) - x[1], jnp.array([(1 + x[0] ** 2) ** 2 + x[1] ** 2 - 4]), NONE


def hock_schittkowski_10(x, params):
    return x[0] - x[1], NONE, jnp.array([-3 * x[0] ** 2 + 2 * x[0] * x[1] - x[1] ** 2 + 1])


def hock_schittkowski_43(x, params):
    a, b, c, d = x
    value = a**2 + b**2 + 2 * c**2 + d**2 - 5 * a - 5 * b - 21 * c + 7 * d
    rows = [
        8 - (x**2).sum() - a + b - c + d,
        10 - a**2 - 2 * b**2 - c**2 - 2 * d**2 + a + d,
        5 - 2 * a**2 - b**2 - c**2 - 2 * a + b + d,
    ]
    return value, NONE, jnp.stack(rows)


def hock_schittkowski_71(x, params):
    value = x[0] * x[3] * (x[0] + x[1] + x[2]) + x[2]
    return value, jnp.array([(x**2).sum() - 40]), jnp.concatenate([jnp.array([jnp.prod(x) - 25]), x - 1, 5 - x])


@pytest.mark.parametrize(
    ("problem", "start", "optimum"),
    [
        (rosenbrock_above, [-2.0, 1.0], 0.0),
        (hock_schittkowski_6, [-1.2, 1.0], 0.0),
        (hock_schittkowski_7, [2.0, 2.0], -np.sqrt(3)),
        (hock_schittkowski_10, [-10.0, 10.0], -1.0),
        (hock_schittkowski_43, [0.0, 0.0, 0.0, 0.0], -44.0),
        (hock_schittkowski_71, [1.0, 5.0, 5.0, 1.0], 17.0140173),
    ],
    ids=["HS1", "HS6", "HS7", "HS10", "HS43", "HS71"],
)
def test_hock_schittkowski(problem, start, optimum):
    """W. Hock, K. Schittkowski, Test Examples for Nonlinear Programming Codes, 1981: optimum values listed there."""
    result = augmented_lagrangian(problem, jnp.array(start), Euclidean(len(start)))
    assert int(result.status) == Status.CONVERGED
    assert float(result.value) == pytest.approx(optimum, abs=1e-5)
    assert float(result.violation) <= 1e-6
    assert int(result.evaluations) <= 100


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_quadratic_programs_agree_with_scipy(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(4, 4))
    data = (
        root @ root.T + 0.2 * np.eye(4),
        rng.normal(size=4),
        rng.normal(size=(1, 4)),
        rng.normal(size=(5, 4)),
        rng.uniform(0, 1, 5),
    )
    h, g, a, c, b = data
    result = solve_quadratic_program(data)
    oracle = scipy.optimize.minimize(
        lambda x: 0.5 * x @ h @ x + g @ x,
        np.zeros(4),
        jac=lambda x: h @ x + g,
        method="SLSQP",
        options={"ftol": 1e-12},
        constraints=[
            {"type": "eq", "fun": lambda x: a @ x, "jac": lambda x: a},
            {"type": "ineq", "fun": lambda x: c @ x + b, "jac": lambda x: c},
        ],
    )
    assert oracle.success
    np.testing.assert_allclose(result.point, oracle.x, atol=1e-4)
    # Karush–Kuhn–Tucker: stationarity, signs, complementarity.
    mu = result.multipliers.inequalities
    stationarity = h @ result.point + g - a.T @ result.multipliers.equalities - c.T @ mu
    np.testing.assert_allclose(stationarity, 0, atol=1e-4)
    assert np.all(mu >= 0)
    np.testing.assert_allclose(mu * (c @ result.point + b), 0, atol=1e-4)


@jax.jit
def solve_quadratic_program(data):
    def problem(x, params):
        h, g, a, c, b = params
        return 0.5 * x @ h @ x + g @ x, a @ x, c @ x + b

    return augmented_lagrangian(problem, jnp.zeros(4), Euclidean(4), Options(300), params=data)


def test_cap_of_the_sphere():
    """The lowest point of the cap x·a ≥ cos α, |x| = 1 lies on its rim, on the meridian of a."""
    tilt, half_angle = 0.9, 0.4
    axis = jnp.array([np.sin(tilt), 0.0, np.cos(tilt)])

    def problem(x, params):
        return x[2], jnp.sum(x**2)[None] - 1, (x @ axis - jnp.cos(half_angle))[None]

    result = jax.jit(jax.vmap(lambda x: augmented_lagrangian(problem, x, Euclidean(3))))(on_the_sphere(8))
    assert np.all(result.status == Status.CONVERGED)
    expected = [np.sin(tilt + half_angle), 0.0, np.cos(tilt + half_angle)]
    np.testing.assert_allclose(result.point, np.tile(expected, (8, 1)), atol=1e-5)


def test_pose_with_pinned_points_on_a_product():
    """A pose that maps p into the plane z = 0 and q onto a movable point (t, 0, 0), closest to a given pose."""
    manifold = Product((SE3(), Euclidean(1)))
    p, q = jnp.array([0.2, 0.1, 0.0]), jnp.array([-0.1, 0.2, 0.1])
    goal = jaxlie.SE3.sample_uniform(jax.random.key(4)).wxyz_xyz

    def problem(point, params):
        pose, t = point
        pose = jaxlie.SE3(pose)
        apart = jaxlie.SE3(goal).as_matrix() - pose.as_matrix()
        pinned = pose @ q - jnp.array([1.0, 0, 0]) * t
        return jnp.sum(apart**2), jnp.concatenate([(pose @ p)[2:], pinned]), 0.5 - t

    result = augmented_lagrangian(problem, (goal, jnp.zeros(1)), manifold)
    assert int(result.status) == Status.CONVERGED
    pose, t = jaxlie.SE3(result.point[0]), result.point[1]
    assert abs(float((pose @ p)[2])) < 1e-6
    np.testing.assert_allclose(pose @ q, [float(t[0]), 0, 0], atol=1e-6)
    assert float(t[0]) <= 0.5 + 1e-6


def test_contradiction_is_reported_infeasible():
    result = augmented_lagrangian(
        lambda x, p: (x[0] ** 2, x - jnp.array([1.0, -1.0]) * jnp.ones(2), NONE), jnp.zeros(2), Euclidean(2)
    )
    assert int(result.status) == Status.CONVERGED
    both = augmented_lagrangian(
        lambda x, p: (x[0] ** 2, jnp.stack([x[0] - 1, x[0] + 1]), NONE), jnp.zeros(1), Euclidean(1)
    )
    assert int(both.status) == Status.INFEASIBLE
    assert float(both.violation) == pytest.approx(1.0, abs=1e-3)


def test_early_stop_at_a_feasible_point_saves_evaluations():
    options = Options(300, gradient_tolerance=1e-12, constraint_tolerance=1e-4)
    start = jnp.array([1.0, 5.0, 5.0, 1.0])
    full = augmented_lagrangian(hock_schittkowski_71, start, Euclidean(4), options)
    early = augmented_lagrangian(
        hock_schittkowski_71, start, Euclidean(4), replace(options, stall=Stall(decrease=1e-3, steps=2))
    )
    assert int(early.status) == Status.STALLED
    assert int(early.evaluations) < int(full.evaluations)
    assert float(early.violation) <= 1e-4
    assert float(early.value) == pytest.approx(float(full.value), abs=1e-2)


def test_budget_returns_the_least_violating_point():
    result = augmented_lagrangian(hock_schittkowski_71, jnp.array([1.0, 5.0, 5.0, 1.0]), Euclidean(4), Options(3))
    assert int(result.status) == Status.BUDGET
    assert int(result.evaluations) == 3


def test_problem_is_traced_once_or_twice():
    traces = []

    def problem(x, params):
        traces.append(1)
        return hock_schittkowski_43(x, params)

    jax.jit(lambda x: augmented_lagrangian(problem, x, Euclidean(4)))(jnp.zeros(4))
    assert len(traces) <= 2  # numbers of constraints, and the loop
    traces.clear()
    jax.jit(lambda x: augmented_lagrangian(problem, x, Euclidean(4), counts=(0, 3)))(jnp.zeros(4))
    assert len(traces) == 1


def test_lockstep_equals_one_by_one():
    starts = jnp.array([[0.0, 0, 0, 0], [1.0, 1, 1, 1], [-1.0, 2, 0, 1]])

    def solve(x):
        return augmented_lagrangian(hock_schittkowski_43, x, Euclidean(4))

    batch, single = jax.jit(jax.vmap(solve))(starts), jax.jit(solve)
    for i, start in enumerate(starts):
        np.testing.assert_array_equal(batch.evaluations[i], single(start).evaluations)
        np.testing.assert_allclose(batch.point[i], single(start).point, atol=1e-9)


def spherical_rosenbrock(x, params):
    return 20.0 * (x[1] - x[0] ** 2) ** 2 + (params - x[0]) ** 2 + x[2]


def test_rosenbrock_on_the_sphere_agrees_with_pymanopt():
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

    result = spherical_solver(on_the_sphere(16), 1.0)
    assert np.all(result.status == Status.CONVERGED)
    assert float(result.value.min()) == pytest.approx(min(costs), abs=1e-9)
    np.testing.assert_allclose(np.linalg.norm(result.point, axis=-1), 1.0, atol=1e-10)


@jax.jit
def spherical_solver(starts, params):
    def problem(x, params):
        return spherical_rosenbrock(x, params), jnp.sum(x**2)[None] - 1, NONE

    options = Options(200, constraint_tolerance=1e-10, gradient_tolerance=1e-8)
    return jax.vmap(lambda x: augmented_lagrangian(problem, x, Euclidean(3), options, params=params))(starts)


def test_same_inputs_give_identical_results():
    one, two = (spherical_solver(on_the_sphere(4, seed=3), 0.7) for _ in range(2))
    jax.tree.map(np.testing.assert_array_equal, one, two)


@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_procrustes_on_se3(seed):
    rng = np.random.default_rng(seed)
    cloud = rng.normal(size=(12, 3)) * [1.0, 0.7, 0.4]
    truth = jaxlie.SE3.sample_uniform(jax.random.key(seed))
    seen = jax.vmap(lambda x: truth @ x)(cloud) + 0.01 * rng.normal(size=cloud.shape)

    result = procrustes_solver(jnp.asarray(cloud), seen)
    best = int(np.argmin(result.value))
    # Kabsch's closed form.
    a, b = cloud - cloud.mean(0), np.asarray(seen) - np.asarray(seen).mean(0)
    u, _, vt = np.linalg.svd(a.T @ b)
    rotation = vt.T @ np.diag([1, 1, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    pose = jaxlie.SE3(result.point[best])
    np.testing.assert_allclose(pose.rotation().as_matrix(), rotation, atol=1e-6)
    np.testing.assert_allclose(pose.translation(), np.asarray(seen).mean(0) - rotation @ cloud.mean(0), atol=1e-6)
    assert int(result.evaluations[best]) < 60


@jax.jit
def procrustes_solver(cloud, seen):
    """From eight starts at once."""

    def misfit(pose, data):
        moved = jax.vmap(lambda x: jaxlie.SE3(pose) @ x)(data[0])
        return 0.5 * jnp.mean(jnp.sum((moved - data[1]) ** 2, axis=1))

    options = Options(200, gradient_tolerance=1e-9)
    starts = jax.vmap(lambda key: jaxlie.SE3.sample_uniform(key).wxyz_xyz)(jax.random.split(jax.random.key(1), 8))
    return jax.vmap(lambda x: augmented_lagrangian(free(misfit), x, SE3(), options, params=(cloud, seen)))(starts)


def test_euclidean_rosenbrock_needs_no_more_evaluations_than_scipy_bfgs():
    def rosenbrock(x, params):
        return jnp.sum(100.0 * (x[1:] - x[:-1] ** 2) ** 2 + (1.0 - x[:-1]) ** 2)

    start = jnp.array([-1.2, 1.0, -1.2, 1.0])
    result = augmented_lagrangian(free(rosenbrock), start, Euclidean(4), Options(200, max_inner=200))
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
    goal = jaxlie.SE3.sample_uniform(jax.random.key(seed))

    result = product_solver(jnp.asarray(direction), center, goal)
    x, pose, y = result.point
    assert int(result.status) == Status.CONVERGED
    np.testing.assert_allclose(x, -direction / np.linalg.norm(direction), atol=1e-6)
    np.testing.assert_allclose(jaxlie.SE3(pose).as_matrix(), goal.as_matrix(), atol=1e-6)
    np.testing.assert_allclose(y, center, atol=1e-6)


@jax.jit
def product_solver(direction, center, goal):
    """A unit vector, a pose and a point of the plane."""

    def problem(point, params):
        x, pose, y = point
        direction, center, goal = params
        apart = jaxlie.SE3(pose).as_matrix() - goal.as_matrix()
        return x @ direction + jnp.sum(apart**2) + jnp.sum((y - center) ** 2), jnp.sum(x**2)[None] - 1, NONE

    # A start that is not antipodal to the goal, where the chordal distance has saddle points.
    near = SE3().retract(goal.wxyz_xyz, jnp.array([0.5, -0.3, 0.2, 0.9, -0.8, 0.4]))
    start = (jnp.array([0.6, 0.0, 0.8]), near, jnp.zeros(2))
    manifold = Product((Euclidean(3), SE3(), Euclidean(2)))
    return augmented_lagrangian(problem, start, manifold, params=(direction, center, goal))


def test_statuses():
    def bowl(x, params):
        return jnp.sum((x - params) ** 2)

    def solve(objective, start, params=(), max_evaluations=200):
        options = Options(max_evaluations)
        return augmented_lagrangian(free(objective), start, Euclidean(2), options, params=params).status

    start = jnp.zeros(2)
    assert solve(bowl, start, 1e3, max_evaluations=5) == Status.BUDGET
    assert solve(bowl, start, 0.0) == Status.CONVERGED
    assert solve(bowl, start, jnp.nan) == Status.NOT_FINITE
    # A wall of NaN beside the start: steps into it are refused, the solver still reaches the minimum.
    assert solve(lambda x, p: jnp.sum(x**2) + 0.0 * jnp.log(x[0] + 0.1), jnp.ones(2)) == Status.CONVERGED
