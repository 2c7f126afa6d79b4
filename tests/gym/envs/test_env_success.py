"""When the target counts as placed, and that reward and ``info`` agree on it."""

from __future__ import annotations

import numpy as np
import pytest
from scenario_facts import still
from scipy.spatial.transform import Rotation

SEED = 3


def at_goal(env, change=None):
    """Put the target at its goal, changed by ``change``, and look after one step."""
    env.reset(seed=SEED)
    unwrapped = env.unwrapped
    pose = np.array(unwrapped.scene.goal_pose)
    if change is not None:
        pose = change(pose, unwrapped.scenario.tolerance)
    unwrapped.world.set_object_pose(unwrapped.scene.target.name, pose)
    return env.step(still(env))


def check_agreement(env, obs, reward, info):
    assert (reward == 0) == info["is_success"]
    assert env.unwrapped.compute_reward(obs["achieved_goal"], obs["desired_goal"], {}) == reward


def turned(axis, degrees):
    def change(pose, _):
        turn = Rotation.from_rotvec(np.deg2rad(degrees) * np.array(axis)) * Rotation.from_quat(np.roll(pose[:4], -1))
        return np.concatenate([np.roll(turn.as_quat(), 1), pose[4:]])

    return change


def shifted(*by):
    """Moved by multiples of the tolerance."""
    return lambda pose, tolerance: pose + tolerance.position * np.concatenate([np.zeros(4), by])


@pytest.mark.parametrize("reward_type", ["sparse", "dense"])
def test_success_at_the_goal(facts, reward_type):
    env = facts.make(reward_type=reward_type)
    assert not env.reset(seed=SEED)[1]["is_success"]
    obs, reward, terminated, _, info = at_goal(env)
    assert info["is_success"]
    assert reward == 0
    assert not terminated
    check_agreement(env, obs, reward, info)
    for _ in range(20):
        *_, info = env.step(still(env))
        assert info["is_success"]


@pytest.mark.parametrize(
    "change",
    [turned([0, 0, 1], 20), turned([0, 0, 1], 180), shifted(1.2, 0, 0), shifted(0, 0, 2.4)],
    ids=["turned too far", "backwards", "beside it", "too high"],
)
def test_no_success_out_of_tolerance(env, change):
    obs, reward, _, _, info = at_goal(env, change)
    assert not info["is_success"]
    check_agreement(env, obs, reward, info)


@pytest.mark.parametrize(
    ("change", "slide", "spin", "moving"),
    [(None, 0, 0, 0), (None, 5, 0, 1), (None, 0, 5, 1), (shifted(0, 0, 0.8), 0, 0, 1)],
    ids=["at rest", "sliding", "spinning", "at the top of a throw"],
)
def test_only_what_rests_is_a_success(env, change, slide, spin, moving):
    env.reset(seed=SEED)
    unwrapped = env.unwrapped
    tolerance = unwrapped.scenario.tolerance
    pose = unwrapped.scene.goal_pose if change is None else change(unwrapped.scene.goal_pose, tolerance)
    velocity = np.array([slide * tolerance.speed, 0, 0, 0, 0, spin * tolerance.turn_rate])
    unwrapped.world.set_object_pose(unwrapped.scene.target.name, pose, velocity)
    obs = unwrapped.set_state(unwrapped.get_state())
    assert obs["achieved_goal"][7] == moving
    assert unwrapped.compute_reward(obs["achieved_goal"], obs["desired_goal"], {}) == -moving


def test_no_success_for_something_resting_elsewhere(env):
    env.reset(seed=SEED)
    for _ in range(5):
        obs, reward, _, _, info = env.step(still(env))
        assert obs["achieved_goal"][7] == 0
        assert not info["is_success"]
        check_agreement(env, obs, reward, info)


def hold_in_the_air(facts, env):
    """Close the gripper around a box, in the air, and keep it there."""
    env.reset(options={"scene": facts.with_box(SEED)})
    unwrapped = env.unwrapped
    name = unwrapped.scene.target.name
    pose = unwrapped.world.gripper_pose
    action = unwrapped.command
    action[-1] = facts.scenario.robot.theta_range[0]
    # Hold it by hand until the fingers do.
    for _ in range(facts.closing_steps):
        unwrapped.world.set_object_pose(name, pose)
        env.step(action)
    for _ in range(20):
        obs, _, _, _, info = env.step(action)
    return obs, info, pose


def test_a_held_target_is_touched_and_never_a_success(facts, env):
    obs, info, pose = hold_in_the_air(facts, env)
    moved = np.linalg.norm(obs["achieved_goal"][4:7] - pose[4:])
    assert moved < 0.4 * facts.scenario.tolerance.position, "friction holds it"
    assert obs["achieved_goal"][8] == 1
    assert obs["achieved_goal"][7] == 1, "nothing but the gripper supports it"
    # Even if the goal were right here.
    here = np.concatenate([obs["achieved_goal"][:7], np.zeros(3)])
    assert env.unwrapped.compute_reward(obs["achieved_goal"], here, {}) == -1
    assert not info["is_success"]


def test_terminate_on_success(facts):
    env = facts.make(terminate_on_success=True)
    env.reset(seed=SEED)
    assert not env.step(still(env))[2]
    assert at_goal(env)[2] is True


def test_compute_reward_is_vectorised_and_needs_no_info(env):
    obs, *_ = at_goal(env)
    achieved = np.stack([obs["achieved_goal"], obs["achieved_goal"] + 1])
    desired = np.stack([obs["desired_goal"]] * 2)
    rewards = env.unwrapped.compute_reward(achieved, desired, [{}])
    np.testing.assert_array_equal(rewards, [0, -1])
