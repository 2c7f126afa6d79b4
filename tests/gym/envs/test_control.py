from __future__ import annotations

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from regrasp_gym.envs.control import CommandLimits, EndEffectorDeltaControl, JointPositionControl, check_action
from regrasp_gym.errors import ActionError

seeds = st.integers(0, 2**32 - 1)
OPEN = np.eye(7)[6]
"""The action that moves nothing, the fingers open."""


@pytest.fixture(scope="module")
def model(facts):
    return facts.scenario.robot.build_spec().compile()


@pytest.fixture(scope="module")
def limits(facts, model):
    robot = facts.scenario.robot
    ranges = np.array([model.joint(name).range for name in robot.arm_joints])
    return CommandLimits(
        np.append(ranges[:, 0], robot.theta_range[0]),
        np.append(ranges[:, 1], robot.theta_range[1]),
        robot.max_velocity * facts.scenario.control_period,
    )


@pytest.fixture(scope="module")
def home(facts):
    robot = facts.scenario.robot
    return np.append(robot.home, robot.theta_range[1])


@pytest.fixture(scope="module")
def ee(facts, model, limits):
    scenario = facts.scenario
    robot = scenario.robot
    return EndEffectorDeltaControl(
        limits, model, robot.arm_joints, robot.tcp_site, scenario.translation_step, scenario.rotation_step
    )


@settings(max_examples=100, deadline=None)
@given(seeds, st.floats(0.1, 20))
def test_commands_keep_limits_and_steps(limits, seed, scale):
    rng = np.random.default_rng(seed)
    control = JointPositionControl(limits)
    last = rng.uniform(limits.lower, limits.upper)
    new = control.command(rng.normal(size=len(last)) * scale, last)
    assert (new >= limits.lower).all()
    assert (new <= limits.upper).all()
    assert (np.abs(new - last)[:-1] <= limits.step + 1e-12).all()


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_a_far_position_is_reached_in_a_straight_line(limits, seed):
    rng = np.random.default_rng(seed)
    control = JointPositionControl(limits)
    start, goal = rng.uniform(limits.lower, limits.upper, (2, len(limits.lower)))
    command, line = start, goal[:-1] - start[:-1]
    for _ in range(int(control.effort(goal, start)) + 2):
        command = control.command(goal, command)
        off = command[:-1] - start[:-1]
        assert np.linalg.norm(off - line * (off @ line) / (line @ line)) < 1e-9
    np.testing.assert_allclose(command, goal, atol=1e-12)


def test_near_positions_are_taken_as_they_are(limits, home):
    wanted = home + 0.5 * np.append(limits.step, 0)
    wanted[-1] = limits.lower[-1] + 0.3 * (limits.upper - limits.lower)[-1]
    np.testing.assert_allclose(JointPositionControl(limits).command(wanted, home), wanted, atol=1e-15)


def test_every_joint_position_in_the_action_space_is_within_the_limits(limits):
    space = JointPositionControl(limits).action_space
    assert (space.low.astype(float) >= limits.lower).all()
    assert (space.high.astype(float) <= limits.upper).all()
    np.testing.assert_allclose(space.low, limits.lower, atol=1e-6)


@settings(max_examples=60, deadline=None)
@given(seeds)
def test_the_gripper_goes_where_the_action_says(facts, limits, home, ee, seed):
    rng = np.random.default_rng(seed)
    last = np.clip(home + np.append(rng.uniform(-0.3, 0.3, facts.joints), 0), limits.lower, limits.upper)
    action = rng.uniform(-1, 1, 7)
    far, turn = facts.scenario.translation_step, facts.scenario.rotation_step
    position, rotation = ee.gripper_frame(last[:-1])
    command = ee.command(action, last)
    at, frame = ee.gripper_frame(command[:-1])
    # Only where the joints are fast enough and their range is wide enough to follow.
    fast = np.abs(command - last)[:-1] < limits.step - 1e-9
    if (fast & (command > limits.lower)[:-1] & (command < limits.upper)[:-1]).all():
        np.testing.assert_allclose(at, position + far * action[:3], atol=1e-3 * far)
        wanted = Rotation.from_rotvec(turn * action[3:6]).as_matrix() @ rotation
        np.testing.assert_allclose(frame, wanted, atol=1e-4)
    low, high = facts.scenario.robot.theta_range
    assert command[-1] == pytest.approx(low + 0.5 * (high - low) * (action[6] + 1))


@pytest.mark.parametrize("axis", range(6))
def test_each_entry_moves_its_own_axis_of_the_world(facts, home, ee, axis):
    action = OPEN.copy()
    action[axis] = 0.1
    position, rotation = ee.gripper_frame(home[:-1])
    at, frame = ee.gripper_frame(ee.command(action, home)[:-1])
    scale = np.repeat([facts.scenario.translation_step, facts.scenario.rotation_step], 3)
    move = np.concatenate([at - position, Rotation.from_matrix(frame @ rotation.T).as_rotvec()]) / scale
    np.testing.assert_allclose(move, action[:6], atol=1e-3)


def test_no_motion_asked_for_means_no_motion(home, ee):
    command = home
    for _ in range(100):
        command = ee.command(OPEN, command)
    np.testing.assert_array_equal(command[:-1], home[:-1])
    assert command[-1] == pytest.approx(home[-1], abs=1e-15)


def test_pushing_against_the_limit_of_reach_does_not_wind_up(facts, limits, home, ee):
    out = OPEN + np.eye(7)[0]
    command = home
    for _ in range(100):
        command = ee.command(out, command)
        assert (command >= limits.lower).all()
        assert (command <= limits.upper).all()
    farthest = ee.gripper_frame(command[:-1])[0][0]
    for _ in range(20):
        command = ee.command(OPEN - np.eye(7)[0], command)
    assert ee.gripper_frame(command[:-1])[0][0] < farthest - 5 * facts.scenario.translation_step


def test_out_of_range_actions_are_clipped(home, ee):
    np.testing.assert_array_equal(ee.command(np.full(7, 9.0), home), ee.command(np.ones(7), home))


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros(6), r"shape \(6,\).*\(7,\)"),
        (np.zeros((1, 7)), r"shape \(1, 7\)"),
        (np.array([0, 0, 0, np.nan, 0, 0, 0]), r"action\[3\] is nan"),
        (np.array([np.inf, 0, 0, 0, 0, 0, 0]), r"action\[0\] is inf"),
        ("up", "not an array of numbers"),
        (None, r"shape \(\)"),
    ],
)
def test_bad_actions_are_named(action, message):
    with pytest.raises(ActionError, match=message):
        check_action(action, spaces.Box(-1, 1, (7,), np.float32))
