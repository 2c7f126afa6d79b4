"""Forward kinematics and its derivatives, and the poses of the bodies."""

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from regrasp_planner.robot.kinematics import (
    body_poses,
    forward_kinematics,
    gripper_jacobian,
    joint_axes,
    pose_error,
    robot_bodies,
)

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


def test_the_gripper_jacobian_is_the_rate_of_the_pose(panda):
    rng, h = np.random.default_rng(3), 1e-6
    q = rng.uniform(panda.arm.lower, panda.arm.upper)
    jacobian = gripper_jacobian(panda.arm, frames_of(panda.arm, jnp.asarray(q)))
    for joint, step in enumerate(h * np.eye(7)):
        behind, ahead = (frames_of(panda.arm, jnp.asarray(q + sign * step))[-1] for sign in (-1, 1))
        np.testing.assert_allclose(jacobian[:, joint], pose_error(behind, ahead) / (2 * h), atol=1e-7)


def test_a_joint_turns_its_link_about_its_axis(panda):
    q = np.array(panda.home)
    before = frames_of(panda.arm, jnp.asarray(q))
    axis, point = joint_axes(panda.arm, before)
    for joint in range(7):
        angle = 0.3
        after = frames_of(panda.arm, jnp.asarray(q + angle * np.eye(7)[joint]))
        turn = Rotation.from_rotvec(angle * np.asarray(axis[joint]))
        moved = turn.apply(before[-1, 4:] - point[joint]) + point[joint]
        np.testing.assert_allclose(after[-1, 4:], moved, atol=1e-12)
