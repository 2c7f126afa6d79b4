from __future__ import annotations

import re

import numpy as np
import pytest

from regrasp_gym.envs.base import RegraspEnv
from regrasp_gym.envs.observation import OTHER_SIZE
from regrasp_gym.envs.reward import GOAL_SIZE, pose_errors

VECTORS = ("observation", "agent_pos", "environment_state")


def part(vector, layout, name):
    start = 0
    for label, count in layout:
        if label == name:
            return vector[start : start + count]
        start += count
    raise KeyError(name)


@pytest.fixture(scope="module")
def state_env(env):
    return env.unwrapped


@pytest.fixture(scope="module")
def pixels_env(facts):
    made = facts.make(obs_type="pixels_agent_pos")
    yield made.unwrapped
    made.close()


def documented_rows(env_class, heading):
    """(first, last) entries of each row of the docstring's table under a heading."""
    table = env_class.__doc__.split(f"| {heading}")[1]
    rows = []
    for line in table.split("\n")[2:]:
        if not line.strip().startswith("|"):
            break
        first, last = re.match(r"\s*\| (\d+)(?:–(\d+))?", line).groups()
        rows.append((int(first), int(last or first)))
    return rows


@pytest.mark.parametrize("name", VECTORS)
def test_docstring_lists_exactly_what_there_is(facts, name):
    expected, start = [], 0
    for _, count in facts.layouts[name]:
        expected.append((start, start + count - 1))
        start += count
    assert documented_rows(facts.env_class, name) == expected
    assert re.search(rf"``{name}`` \({start},\)", facts.env_class.__doc__)


def test_docstring_lists_every_joint_with_its_limits(facts, state_env):
    """The first table of actions is that of joint positions."""
    table = facts.env_class.__doc__.split("| Num | Action")[1].split("\n\n")[0]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.split("\n")[2:]]
    robot, space = facts.scenario.robot, state_env.action_space
    assert [int(row[0]) for row in rows] == list(range(facts.joints + 1))
    assert [row[4] for row in rows] == [*robot.arm_actuators, robot.gripper_actuator]
    np.testing.assert_allclose([float(row[2]) for row in rows], space.low, atol=6e-5)
    np.testing.assert_allclose([float(row[3]) for row in rows], space.high, atol=6e-5)


def test_goal_is_documented():
    rows = documented_rows(RegraspEnv, "achieved_goal")
    assert rows[0] == (0, 6)
    assert rows[-1] == (GOAL_SIZE - 1, GOAL_SIZE - 1)


def test_state_vector_says_what_is_there(facts, state_env):
    obs, _ = state_env.reset(seed=4)
    world, scene, layout = state_env.world, state_env.scene, facts.layouts["observation"]
    robot, room = facts.scenario.robot, facts.scenario.max_others
    vector = obs["observation"]
    np.testing.assert_allclose(part(vector, layout, "joint positions"), robot.home)
    np.testing.assert_allclose(part(vector, layout, "finger coordinate"), robot.theta_range[1])
    np.testing.assert_array_equal(part(vector, layout, "gripper pose"), world.gripper_pose)
    np.testing.assert_allclose(part(vector, layout, "target half extents"), scene.target.model.size / 2)
    others = part(vector, layout, "other objects").reshape(room, OTHER_SIZE)
    count = len(scene.others)
    np.testing.assert_array_equal(others[:, 0], np.arange(room) < count)
    assert not others[count:].any()
    for row, thing in zip(others, scene.others, strict=False):
        assert max(pose_errors(row[1:8], thing.pose)) < 1e-9
        np.testing.assert_allclose(row[8:], thing.model.size / 2)
    assert max(pose_errors(obs["achieved_goal"], scene.target.pose)) < 1e-9
    assert max(pose_errors(obs["desired_goal"], scene.goal_pose)) < 1e-9
    reach = np.linalg.norm(world.gripper_pose[4:] - scene.target.pose[4:])
    assert obs["achieved_goal"][9] == pytest.approx(reach)


def test_pixels_follow_lerobots_contract(facts, pixels_env):
    obs, _ = pixels_env.reset(seed=4)
    assert set(obs) == {"pixels", "agent_pos", "environment_state"}
    assert set(obs["pixels"]) == set(facts.scenario.pixels)
    for picture in obs["pixels"].values():
        assert picture.shape == (128, 128, 3)
        assert picture.dtype == np.uint8
    assert obs["agent_pos"].shape == pixels_env.action_space.shape
    robot = facts.scenario.robot
    np.testing.assert_allclose(obs["agent_pos"], np.append(robot.home, robot.theta_range[1]))
    layout, scene = facts.layouts["environment_state"], pixels_env.scene
    vector = obs["environment_state"]
    assert max(pose_errors(part(vector, layout, "target pose"), scene.target.pose)) < 1e-9
    assert max(pose_errors(part(vector, layout, "goal pose"), scene.goal_pose)) < 1e-9
    np.testing.assert_allclose(part(vector, layout, "target half extents"), scene.target.model.size / 2)


def test_both_types_tell_the_same(facts, state_env, pixels_env):
    state, _ = state_env.reset(seed=9)
    pixels, _ = pixels_env.reset(seed=9)
    for name in ("other objects", "target half extents"):
        np.testing.assert_array_equal(
            part(state["observation"], facts.layouts["observation"], name),
            part(pixels["environment_state"], facts.layouts["environment_state"], name),
        )


def test_velocities_are_those_of_the_world_frame(facts, state_env):
    # High in the air, where it touches nothing.
    start = np.array([0.5, 0.5, -0.5, 0.5, -20.0, 0.0, 20.0])
    velocity = np.array([0.1, -0.2, 0.3, 0.5, 1.0, -2.0])
    state_env.reset(seed=4)
    world, name = state_env.world, state_env.scene.target.name
    world.set_object_pose(name, start, velocity)
    obs = state_env.set_state(state_env.get_state())
    np.testing.assert_allclose(
        part(obs["observation"], facts.layouts["observation"], "target velocity"), velocity, atol=1e-12
    )
    np.testing.assert_allclose(world.target_velocity, velocity, atol=1e-12)
    # One short step moves it as the velocity says.
    world.run(state_env.command, state_env.command, 1)
    moved = world.target_pose
    dt = world.model.opt.timestep
    np.testing.assert_allclose(moved[4:] - start[4:], velocity[:3] * dt, atol=9.81 * dt * dt + 1e-9)
    angle = pose_errors(moved, start)[1]
    assert angle == pytest.approx(np.linalg.norm(velocity[3:]) * dt, rel=0.02)


def test_observations_are_in_their_spaces(state_env, pixels_env):
    for env in (state_env, pixels_env):
        for seed in range(3):
            assert env.observation_space.contains(env.reset(seed=seed)[0])
            assert env.observation_space.contains(env.step(env.action_space.sample())[0])
