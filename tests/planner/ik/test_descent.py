"""Damped least squares, and the small linear solver in it."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp_planner.ik.descent import descend_to_pose, solve_positive

seeds = st.integers(0, 2**31 - 1)


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_descent_inverts_forward_kinematics(panda, gripper_poses, random_configurations, pose_errors, seed):
    truth = random_configurations(panda.arm, 8, seed)
    targets = gripper_poses(panda.arm, truth)
    starts = random_configurations(panda.arm, 8 * 32, seed + 1).reshape(8, 32, 7)
    found = descend_to_pose(panda.arm, targets, starts, 3, 60)
    best = np.argmin(found.position_error + found.rotation_error, axis=1)
    q = found.q[np.arange(8), best]
    position, rotation = pose_errors(panda.arm, q, targets)
    assert position.max() < 1e-5
    assert rotation.max() < 1e-5
    assert np.all(q >= panda.arm.lower)
    assert np.all(q <= panda.arm.upper)


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_small_solver_agrees_with_numpy(seed):
    rng = np.random.default_rng(seed)
    root, right = rng.normal(size=(6, 6)), rng.normal(size=6)
    matrix = root @ root.T + 1e-3 * np.eye(6)
    np.testing.assert_allclose(
        jax.jit(solve_positive)(jnp.asarray(matrix), jnp.asarray(right)), np.linalg.solve(matrix, right), rtol=1e-6
    )
