"""Inverse kinematics of the oracle."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import regrasp_gym  # noqa: F401
from regrasp_bench.oracle.exhaustive_ik import ExhaustiveIk, ExhaustiveIkOptions
from regrasp_planner.robot.kinematics import forward_kinematics


@pytest.fixture(scope="module")
def ik(robot):
    return ExhaustiveIk(robot, ExhaustiveIkOptions(bank=8000))


def test_forward_kinematics_agree_with_the_planner(robot, ik):
    q = np.random.default_rng(2).uniform(ik.lower, ik.upper, (20, 7))
    turns, shifts = ik.forward(q)
    frames = np.asarray(jax.vmap(lambda angles: forward_kinematics(robot.arm, angles))(q))
    np.testing.assert_allclose(shifts, frames[..., 4:], atol=1e-9)
    quaternions = Rotation.from_quat(frames[..., :4].reshape(-1, 4), scalar_first=True)
    np.testing.assert_allclose(turns.reshape(-1, 3, 3), quaternions.as_matrix(), atol=1e-9)


def test_poses_of_known_configurations_are_reached(ik):
    low, high = ik.lower, ik.upper
    middle, span = (low + high) / 2, (high - low) / 2
    q = np.random.default_rng(3).uniform(middle - 0.8 * span, middle + 0.8 * span, (60, 7))
    turns, shifts = ik.forward(q)
    found, owner = ik.solve(turns[:, -1], shifts[:, -1])
    assert len(np.unique(owner)) >= 58
    assert ((found >= low) & (found <= high)).all()
    again_turns, again_shifts = ik.forward(found)
    np.testing.assert_allclose(again_shifts[:, -1], shifts[owner, -1], atol=1.1e-4)
    np.testing.assert_allclose(again_turns[:, -1], turns[owner, -1], atol=1e-3)


def test_what_is_out_of_reach_is_not_reached(ik):
    found, _ = ik.solve(np.eye(3)[None], np.array([[1.6, 0.0, 0.3]]))
    assert len(found) == 0
