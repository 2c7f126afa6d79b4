from __future__ import annotations

import re

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import regrasp_gym  # noqa: F401  registers the environments
from regrasp_gym import observation
from regrasp_gym.envs.panda_ycb import PandaYCBEnv
from regrasp_gym.envs.world import canonical
from regrasp_gym.reward import GOAL_SIZE, pose_errors

LAYOUTS = {
    "observation": observation.state_layout(7, 8),
    "agent_pos": observation.agent_layout(7),
    "environment_state": observation.environment_layout(8),
}


def part(vector, layout, name):
    start = 0
    for label, count in layout:
        if label == name:
            return vector[start : start + count]
        start += count
    raise KeyError(name)


@pytest.fixture(scope="module")
def state_env():
    return gym.make("regrasp_gym/PandaYCB-v0").unwrapped


@pytest.fixture(scope="module")
def pixels_env():
    return gym.make("regrasp_gym/PandaYCB-v0", obs_type="pixels_agent_pos").unwrapped


def documented_rows(heading):
    """(first, last) entries of each row of the docstring's table under a heading."""
    table = PandaYCBEnv.__doc__.split(f"| {heading}")[1]
    rows = []
    for line in table.split("\n")[2:]:
        if not line.strip().startswith("|"):
            break
        first, last = re.match(r"\s*\| (\d+)(?:–(\d+))?", line).groups()
        rows.append((int(first), int(last or first)))
    return rows


@pytest.mark.parametrize("name", LAYOUTS)
def test_docstring_lists_exactly_what_there_is(name):
    expected, start = [], 0
    for _, count in LAYOUTS[name]:
        expected.append((start, start + count - 1))
        start += count
    assert documented_rows(name) == expected


def test_goal_is_documented():
    rows = documented_rows("achieved_goal")
    assert rows[0] == (0, 6)
    assert rows[-1] == (GOAL_SIZE - 1, GOAL_SIZE - 1)


def test_state_vector_says_what_is_there(state_env):
    obs, _ = state_env.reset(seed=4)
    world, scene, layout = state_env.world, state_env.scene, LAYOUTS["observation"]
    vector = obs["observation"]
    np.testing.assert_allclose(part(vector, layout, "joint positions"), state_env.scenario.robot.home)
    np.testing.assert_allclose(part(vector, layout, "finger coordinate"), 0.04)
    np.testing.assert_array_equal(part(vector, layout, "gripper pose"), world.gripper_pose)
    np.testing.assert_allclose(part(vector, layout, "target half extents"), scene.target.model.size / 2)
    others = part(vector, layout, "other objects").reshape(8, 11)
    count = len(scene.others)
    np.testing.assert_array_equal(others[:, 0], np.arange(8) < count)
    assert not others[count:].any()
    for row, thing in zip(others, scene.others, strict=False):
        assert max(pose_errors(row[1:8], thing.pose)) < 1e-9
        np.testing.assert_allclose(row[8:], thing.model.size / 2)
    assert max(pose_errors(obs["achieved_goal"], scene.target.pose)) < 1e-9
    assert max(pose_errors(obs["desired_goal"], scene.goal_pose)) < 1e-9
    reach = np.linalg.norm(world.gripper_pose[4:] - scene.target.pose[4:])
    assert obs["achieved_goal"][9] == pytest.approx(reach)


def test_pixels_follow_lerobots_contract(pixels_env):
    obs, _ = pixels_env.reset(seed=4)
    assert set(obs) == {"pixels", "agent_pos", "environment_state"}
    assert set(obs["pixels"]) == {"front", "wrist"}
    for picture in obs["pixels"].values():
        assert picture.shape == (128, 128, 3)
        assert picture.dtype == np.uint8
    assert obs["agent_pos"].shape == pixels_env.action_space.shape
    np.testing.assert_allclose(obs["agent_pos"], np.append(pixels_env.scenario.robot.home, 0.04))
    layout, scene = LAYOUTS["environment_state"], pixels_env.scene
    vector = obs["environment_state"]
    assert max(pose_errors(part(vector, layout, "target pose"), scene.target.pose)) < 1e-9
    assert max(pose_errors(part(vector, layout, "goal pose"), scene.goal_pose)) < 1e-9
    np.testing.assert_allclose(part(vector, layout, "target half extents"), scene.target.model.size / 2)


def test_both_types_tell_the_same(state_env, pixels_env):
    state, _ = state_env.reset(seed=9)
    pixels, _ = pixels_env.reset(seed=9)
    for name in ("other objects", "target half extents"):
        np.testing.assert_array_equal(
            part(state["observation"], LAYOUTS["observation"], name),
            part(pixels["environment_state"], LAYOUTS["environment_state"], name),
        )


def test_velocities_are_those_of_the_world_frame(state_env):
    state_env.reset(seed=4)
    world, name = state_env.world, state_env.scene.target.name
    start = np.array([0.5, 0.5, -0.5, 0.5, 0.4, 0.0, 0.6])
    velocity = np.array([0.1, -0.2, 0.3, 0.5, 1.0, -2.0])
    world.set_object_pose(name, start, velocity)
    obs = state_env.set_state(state_env.get_state())
    np.testing.assert_allclose(
        part(obs["observation"], LAYOUTS["observation"], "target velocity"), velocity, atol=1e-12
    )
    np.testing.assert_allclose(world.target_velocity, velocity, atol=1e-12)
    # One short step moves it as the velocity says.
    world.run(state_env.command, state_env.command, 1)
    moved = world.target_pose
    dt = world.model.opt.timestep
    np.testing.assert_allclose(moved[4:] - start[4:], velocity[:3] * dt, atol=9.81 * dt * dt + 1e-9)
    angle = pose_errors(moved, start)[1]
    assert angle == pytest.approx(np.linalg.norm(velocity[3:]) * dt, rel=0.02)


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


def test_observations_are_in_their_spaces(state_env, pixels_env):
    for env in (state_env, pixels_env):
        for seed in range(3):
            assert env.observation_space.contains(env.reset(seed=seed)[0])
            assert env.observation_space.contains(env.step(env.action_space.sample())[0])
