from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from regrasp_gym.geometry.poses import canonical, mujoco_quaternion, shepperd_quaternion, to_pose, turning_down


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_canonical_quaternions_are_the_same_rotation_with_one_sign(seed):
    rng = np.random.default_rng(seed)
    poses = rng.normal(size=(5, 7))
    once = canonical(poses)
    np.testing.assert_allclose(np.linalg.norm(once[:, :4], axis=1), 1)
    flipped = poses * np.array([-1] * 4 + [1] * 3)
    np.testing.assert_array_equal(canonical(flipped), once)
    np.testing.assert_allclose(canonical(once), once, atol=1e-15)
    aligned = np.abs(np.einsum("ij,ij->i", once[:, :4], poses[:, :4]))
    np.testing.assert_allclose(aligned, np.linalg.norm(poses[:, :4], axis=1))


def test_noise_does_not_toggle_the_sign_of_what_lies_upside_down():
    rng = np.random.default_rng(0)
    yaw = rng.uniform(-np.pi, np.pi, 200)
    for axis in (np.array([1.0, 0, 0]), np.array([0, 1.0, 0])):
        flip = np.column_stack([np.zeros(200), np.cos(yaw)[:, None] * axis[:2] + np.sin(yaw)[:, None] * axis[1::-1]])
        poses = np.column_stack([flip, np.zeros((200, 4))])
        noisy = poses + 1e-6 * rng.normal(size=poses.shape)
        same = np.linalg.norm(canonical(poses) - canonical(noisy), axis=1) < 1e-3
        assert same.all()


@pytest.mark.parametrize("convert", [shepperd_quaternion, mujoco_quaternion])
def test_quaternions_agree_with_scipy(convert):
    rotations = Rotation.random(200, random_state=0)
    half_turns = Rotation.from_rotvec(np.pi * np.eye(3))
    for rotation in (*rotations, *half_turns):
        expected = rotation.as_quat(scalar_first=True)
        pose = to_pose(convert(rotation.as_matrix()), [1.0, 2.0, 3.0])
        assert pose[0] >= 0
        assert abs(pose[:4] @ expected) == pytest.approx(1)
        np.testing.assert_array_equal(pose[4:], [1, 2, 3])


def test_the_least_turn_down():
    for direction in (*np.random.default_rng(0).normal(size=(50, 3)), [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]):
        unit = np.asarray(direction) / np.linalg.norm(direction)
        rotation = turning_down(unit)
        np.testing.assert_allclose(rotation @ unit, [0, 0, -1], atol=1e-12)
        assert Rotation.from_matrix(rotation).magnitude() == pytest.approx(np.arccos(np.clip(-unit[2], -1, 1)))
