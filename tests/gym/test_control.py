from __future__ import annotations

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from regrasp_gym.control import CommandLimits, EndEffectorDeltaControl, JointPositionControl, check_action
from regrasp_gym.envs.panda_ycb import PANDA, PANDA_YCB
from regrasp_gym.errors import ActionError

MODEL = PANDA.build_spec().compile()
RANGES = np.array([MODEL.joint(name).range for name in PANDA.arm_joints])
LIMITS = CommandLimits(
    np.append(RANGES[:, 0], 0.0), np.append(RANGES[:, 1], 0.04), PANDA.max_velocity * PANDA_YCB.control_period
)
HOME = np.append(PANDA.home, 0.04)
seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def ee():
    return EndEffectorDeltaControl(LIMITS, MODEL, PANDA.arm_joints, PANDA.tcp_site, 0.02, 0.1)


@settings(max_examples=100, deadline=None)
@given(seeds, st.floats(0.1, 20))
def test_commands_keep_limits_and_steps(seed, scale):
    rng = np.random.default_rng(seed)
    control = JointPositionControl(LIMITS)
    last = rng.uniform(LIMITS.lower, LIMITS.upper)
    new = control.command(rng.normal(size=8) * scale, last)
    assert (new >= LIMITS.lower).all()
    assert (new <= LIMITS.upper).all()
    assert (np.abs(new - last)[:-1] <= LIMITS.step + 1e-12).all()


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_a_far_position_is_reached_in_a_straight_line(seed):
    rng = np.random.default_rng(seed)
    control = JointPositionControl(LIMITS)
    start, goal = rng.uniform(LIMITS.lower, LIMITS.upper, (2, 8))
    command, line = start, goal[:-1] - start[:-1]
    for _ in range(200):
        command = control.command(goal, command)
        off = command[:-1] - start[:-1]
        assert np.linalg.norm(off - line * (off @ line) / (line @ line)) < 1e-9
    np.testing.assert_allclose(command, goal, atol=1e-12)


def test_near_positions_are_taken_as_they_are():
    wanted = HOME + 0.05
    wanted[-1] = 0.013
    np.testing.assert_allclose(JointPositionControl(LIMITS).command(wanted, HOME), wanted, atol=1e-15)


def test_every_joint_position_in_the_action_space_is_within_the_limits():
    space = JointPositionControl(LIMITS).action_space
    assert (space.low.astype(float) >= LIMITS.lower).all()
    assert (space.high.astype(float) <= LIMITS.upper).all()
    np.testing.assert_allclose(space.low, LIMITS.lower, atol=1e-6)


@settings(max_examples=60, deadline=None)
@given(seeds)
def test_the_gripper_goes_where_the_action_says(ee, seed):
    rng = np.random.default_rng(seed)
    last = HOME + np.append(rng.uniform(-0.3, 0.3, 7), 0)
    action = rng.uniform(-1, 1, 7)
    position, rotation = ee.gripper_frame(last[:-1])
    command = ee.command(action, last)
    at, frame = ee.gripper_frame(command[:-1])
    # Only where the joints are fast enough to follow.
    if (np.abs(command - last)[:-1] < LIMITS.step - 1e-9).all():
        np.testing.assert_allclose(at, position + 0.02 * action[:3], atol=2e-5)
        wanted = Rotation.from_rotvec(0.1 * action[3:6]).as_matrix() @ rotation
        np.testing.assert_allclose(frame, wanted, atol=1e-4)
    assert command[-1] == pytest.approx(0.02 * (action[6] + 1))


@pytest.mark.parametrize("axis", range(6))
def test_each_entry_moves_its_own_axis_of_the_world(ee, axis):
    action = np.zeros(7)
    action[axis] = 0.5
    position, rotation = ee.gripper_frame(HOME[:-1])
    at, frame = ee.gripper_frame(ee.command(action, HOME)[:-1])
    move = np.concatenate([at - position, Rotation.from_matrix(frame @ rotation.T).as_rotvec()])
    expected = np.zeros(6)
    expected[axis] = 0.01 if axis < 3 else 0.05
    np.testing.assert_allclose(move, expected, atol=2e-5)


def test_no_motion_asked_for_means_no_motion(ee):
    command = HOME
    for _ in range(100):
        command = ee.command(np.array([0, 0, 0, 0, 0, 0, 1.0]), command)
    np.testing.assert_array_equal(command, HOME)


def test_pushing_against_the_limit_of_reach_does_not_wind_up(ee):
    out = np.array([1.0, 0, 0, 0, 0, 0, 1.0])
    command = HOME
    for _ in range(60):
        command = ee.command(out, command)
        assert (command >= LIMITS.lower).all()
        assert (command <= LIMITS.upper).all()
    farthest = ee.gripper_frame(command[:-1])[0][0]
    for _ in range(10):
        command = ee.command(-out, command)
    assert ee.gripper_frame(command[:-1])[0][0] < farthest - 0.1


def test_out_of_range_actions_are_clipped(ee):
    np.testing.assert_array_equal(ee.command(np.full(7, 9.0), HOME), ee.command(np.ones(7), HOME))


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros(6), r"shape \(6,\).*\(7,\)"),
        (np.zeros((1, 7)), r"shape \(1, 7\)"),
        (np.array([0, 0, 0, np.nan, 0, 0, 0]), r"action\[3\] is nan"),
        (np.array([np.inf, 0, 0, 0, 0, 0, 0]), r"action\[0\] is inf"),
        ("up", "no array of numbers"),
        (None, r"shape \(\)"),
    ],
)
def test_bad_actions_are_named(action, message):
    with pytest.raises(ActionError, match=message):
        check_action(action, spaces.Box(-1, 1, (7,), np.float32))
