from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from regrasp_gym.envs.reward import GOAL_SIZE, dense_reward, is_success, pose_errors, sparse_reward
from regrasp_gym.simulation.scenario import Tolerance

TOLERANCE = Tolerance()
seeds = st.integers(0, 2**32 - 1)


def goal(rng, position=None, moving=0.0, touched=0.0, reach=0.3):
    quaternion = rng.normal(size=4)
    place = rng.uniform(-1, 1, 3) if position is None else position
    return np.concatenate([quaternion / np.linalg.norm(quaternion), place, [moving, touched, reach]])


def moved(start, shift, rotation):
    turn = rotation * Rotation.from_quat(np.roll(start[:4], -1))
    return np.concatenate([np.roll(turn.as_quat(), 1), start[4:7] + shift, start[7:]])


@settings(max_examples=100, deadline=None)
@given(seeds, st.floats(0, 0.5), st.floats(0, np.pi))
def test_pose_errors_are_the_move_that_was_made(seed, length, angle):
    rng = np.random.default_rng(seed)
    start, axis = goal(rng), rng.normal(size=3)
    shift = rng.normal(size=3)
    shift *= length / np.linalg.norm(shift)
    end = moved(start, shift, Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)))
    distance, turned = pose_errors(start, end)
    assert distance == pytest.approx(length, abs=1e-12)
    assert turned == pytest.approx(angle, abs=1e-7)
    end[:4] *= -1
    assert pose_errors(start, end)[1] == pytest.approx(turned, abs=1e-12)


def test_small_angles_are_not_lost():
    rng = np.random.default_rng(0)
    start = goal(rng)
    end = moved(start, np.zeros(3), Rotation.from_rotvec([1e-9, 0, 0]))
    assert pose_errors(start, end)[1] == pytest.approx(1e-9, rel=1e-5)


@pytest.mark.parametrize(
    ("shift", "degrees", "moving", "touched", "expected"),
    [
        (0.0, 0.0, 0, 0, True),
        (0.0249, 14.9, 0, 0, True),
        (0.0251, 0.0, 0, 0, False),
        (0.0, 15.1, 0, 0, False),
        (0.0, 180.0, 0, 0, False),
        (0.0, 0.0, 1, 0, False),
        (0.0, 0.0, 0, 1, False),
    ],
)
def test_success_needs_place_rest_and_release(shift, degrees, moving, touched, expected):
    rng = np.random.default_rng(1)
    desired = goal(rng, reach=0.0)
    achieved = moved(desired, [shift, 0, 0], Rotation.from_euler("y", degrees, degrees=True))
    achieved[7:9] = moving, touched
    assert bool(is_success(achieved, desired, TOLERANCE)) is expected
    assert sparse_reward(achieved, desired, TOLERANCE) == (0.0 if expected else -1.0)
    assert (dense_reward(achieved, desired, TOLERANCE) == 0.0) == expected


def test_a_relabelled_goal_is_reached_by_the_state_it_came_from():
    rng = np.random.default_rng(2)
    for moving in (0.0, 1.0):
        for touched in (0.0, 1.0):
            state = goal(rng, moving=moving, touched=touched, reach=0.1)
            assert is_success(state, state, TOLERANCE)


def test_a_goal_held_in_the_air_is_also_reached_at_rest():
    rng = np.random.default_rng(3)
    held = goal(rng, moving=1.0, touched=1.0)
    rest = held.copy()
    rest[7:9] = 0
    assert is_success(rest, held, TOLERANCE)
    assert not is_success(held, rest, TOLERANCE)


@settings(max_examples=60, deadline=None)
@given(seeds)
def test_batches_give_what_single_goals_give(seed):
    rng = np.random.default_rng(seed)
    achieved = np.array([goal(rng, moving=rng.integers(2), touched=rng.integers(2)) for _ in range(6)])
    desired = np.array([goal(rng) for _ in range(6)])
    achieved[0, :9] = desired[0, :9]
    for function in (sparse_reward, dense_reward):
        batch = function(achieved, desired, TOLERANCE)
        assert batch.shape == (6,)
        np.testing.assert_array_equal(
            batch, [function(a, d, TOLERANCE) for a, d in zip(achieved, desired, strict=True)]
        )
        grid = function(achieved.reshape(2, 3, GOAL_SIZE), desired.reshape(2, 3, GOAL_SIZE), TOLERANCE)
        np.testing.assert_array_equal(grid.ravel(), batch)


@settings(max_examples=100, deadline=None)
@given(seeds)
def test_dense_reward_is_bounded_and_below_success(seed):
    rng = np.random.default_rng(seed)
    achieved = goal(rng, moving=1.0, reach=rng.uniform(0, 2))
    value = dense_reward(achieved, goal(rng), TOLERANCE)
    assert -1.0 <= value <= -0.05


def test_dense_reward_rises_towards_the_goal_and_towards_the_target():
    rng = np.random.default_rng(4)
    desired = goal(rng)
    along = [
        dense_reward(moved(desired, [0, 0, d], Rotation.identity()), desired, TOLERANCE)
        for d in (0.6, 0.4, 0.2, 0.1, 0.05)
    ]
    assert (np.diff(along) > 0).all()
    turned = [
        dense_reward(moved(desired, [0.1, 0, 0], Rotation.from_rotvec([0, 0, a])), desired, TOLERANCE)
        for a in (3.0, 2.0, 1.0, 0.0)
    ]
    assert (np.diff(turned) > 0).all()
    far = moved(desired, [0.3, 0, 0], Rotation.identity())
    near = []
    for reach in (0.5, 0.3, 0.1, 0.0):
        far[9] = reach
        near.append(dense_reward(far, desired, TOLERANCE))
    assert (np.diff(near) > 0).all()


def test_letting_go_at_the_goal_costs_nothing():
    rng = np.random.default_rng(5)
    desired = goal(rng)
    held = desired.copy()
    held[7:] = 1, 1, 0.01
    left = held.copy()
    left[9] = 0.6
    assert dense_reward(held, desired, TOLERANCE) == dense_reward(left, desired, TOLERANCE)
