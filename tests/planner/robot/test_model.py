"""Forward kinematics, gripper motion and configuration checks."""

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from regrasp_planner.robot.kinematics import body_poses, forward_kinematics, robot_bodies
from regrasp_planner.robot.model import check_configuration

frames_of = jax.jit(forward_kinematics)
seeds = st.integers(0, 2**31 - 1)


def matrices_by_denavit_hartenberg(q):
    """Craig's parameters of the Panda (franka_ros): transforms of joints 1…7 and of the flange."""
    a = [0, 0, 0, 0.0825, -0.0825, 0, 0.088]
    alpha = [0, -np.pi / 2, np.pi / 2, np.pi / 2, -np.pi / 2, np.pi / 2, np.pi / 2]
    d = [0.333, 0, 0.316, 0, 0.384, 0, 0]
    pose, poses = np.eye(4), []
    for ai, ali, di, qi in zip(a, alpha, d, q, strict=True):
        ca, sa, cq, sq = np.cos(ali), np.sin(ali), np.cos(qi), np.sin(qi)
        pose = pose @ np.array(
            [[cq, -sq, 0, ai], [sq * ca, cq * ca, -sa, -sa * di], [sq * sa, cq * sa, ca, ca * di], [0, 0, 0, 1]]
        )
        poses.append(pose)
    return poses


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_forward_kinematics_agrees_with_denavit_hartenberg(panda, seed):
    q = np.random.default_rng(seed).uniform(panda.arm.lower, panda.arm.upper)
    frames = np.asarray(frames_of(panda.arm, jnp.asarray(q)))
    assert frames.shape == (9, 7)
    np.testing.assert_allclose(np.linalg.norm(frames[:, :4], axis=1), 1.0, atol=1e-12)
    expected = matrices_by_denavit_hartenberg(q)
    for frame, matrix in zip(frames[1:-1], expected, strict=True):
        np.testing.assert_allclose(jaxlie.SE3(frame).as_matrix(), matrix, atol=1e-12)
    tool = np.eye(4)
    tool[:3, :3] = Rotation.from_euler("z", -np.pi / 4).as_matrix()
    tool[2, 3] = 0.107 + 0.1034
    np.testing.assert_allclose(jaxlie.SE3(frames[-1]).as_matrix(), expected[-1] @ tool, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_forward_kinematics_derivative(panda, seed):
    rng = np.random.default_rng(seed)
    q, direction, h = jnp.asarray(rng.uniform(panda.arm.lower, panda.arm.upper)), rng.normal(size=7), 1e-6
    _, slope = jax.jvp(lambda x: forward_kinematics(panda.arm, x), (q,), (jnp.asarray(direction),))
    difference = (frames_of(panda.arm, q + h * direction) - frames_of(panda.arm, q - h * direction)) / (2 * h)
    np.testing.assert_allclose(slope, difference, atol=1e-7)


def test_bodies_ride_on_their_frames(panda):
    q, theta = jnp.asarray(panda.home), jnp.asarray(0.03)
    frames, poses = forward_kinematics(panda.arm, q), body_poses(panda, q, theta)
    n_links, n_palm = panda.links.batch_size, panda.gripper.palm.batch_size
    assert len(poses) == robot_bodies(panda).batch_size
    np.testing.assert_allclose(poses[:n_links], frames[panda.link_of], atol=1e-12)
    np.testing.assert_allclose(poses[n_links : n_links + n_palm], np.tile(frames[-1], (n_palm, 1)), atol=1e-12)
    # Fingers open along ±y of the gripper frame by θ each.
    hand = jaxlie.SE3(frames[-1])
    for finger, side in enumerate((1, -1)):
        moved = hand.inverse() @ jaxlie.SE3(poses[n_links + n_palm + finger])
        np.testing.assert_allclose(moved.translation(), [0, side * 0.03, 0], atol=1e-12)


def test_check_configuration_names_the_joint(panda):
    check_configuration(panda, panda.home)
    beyond = panda.home.copy()
    beyond[3] = 0.5
    with pytest.raises(ValueError, match=r"'joint4' is at 0\.5000 rad"):
        check_configuration(panda, beyond)
    with pytest.raises(ValueError, match="not finite"):
        check_configuration(panda, np.full(7, np.nan))
    with pytest.raises(ValueError, match=r"shape \(3,\)"):
        check_configuration(panda, np.zeros(3))
