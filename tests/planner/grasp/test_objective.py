"""Derivatives of the grasp problem against finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from regrasp_planner.grasp.grasp import GraspGenOptions
from regrasp_planner.grasp.objective import grasp_objective
from regrasp_planner.grasp.problem import grasp_problem
from regrasp_planner.optim.manifold import SE3, Euclidean, Product


@pytest.mark.parametrize("seed", range(4))
def test_derivatives_of_the_problem_match_finite_differences(panda, bodies, scenes, seed):
    problem = grasp_problem(bodies.box(), scenes, panda.gripper, GraspGenOptions())
    rng = np.random.default_rng(seed)
    quaternion = rng.normal(size=4)
    pose = np.concatenate([quaternion / np.linalg.norm(quaternion), rng.normal(scale=0.08, size=3)])
    point = (jnp.asarray(pose), jnp.asarray([0.4]))
    manifold = Product((SE3(length=0.08), Euclidean(1)))

    def flat(xi):
        value, equalities, inequalities = grasp_objective(manifold.retract(point, xi), problem)
        return jnp.concatenate([value[None], equalities, inequalities])

    evaluate = jax.jit(flat)
    exact = np.asarray(jax.jit(jax.jacfwd(flat))(jnp.zeros(7)))
    step = 1e-6
    numeric = np.stack(
        [(np.asarray(evaluate(step * e)) - np.asarray(evaluate(-step * e))) / (2 * step) for e in np.eye(7)], axis=1
    )
    # Obstacles that only pad the batch are a kilometre away, where rounding of the values alone is larger.
    near = np.abs(np.asarray(evaluate(np.zeros(7)))) < 100
    scale = np.maximum(np.abs(exact[near]).max(axis=1, keepdims=True), 1.0)
    assert near.sum() > 10
    np.testing.assert_array_less(np.abs(exact[near] - numeric[near]) / scale, 1e-5)
