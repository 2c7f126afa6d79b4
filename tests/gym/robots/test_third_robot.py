"""A robot that the package does not know, added as `docs/adding-a-robot.md` says; `ur_like` is what that takes."""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import ur_like
from gymnasium.utils.env_checker import check_env

import regrasp_gym
from regrasp_bench.tables.episodes import run_episode
from regrasp_gym.envs.reward import pose_errors
from regrasp_planner.robot.kinematics import forward_kinematics

DIRECT_SEED, REGRASP_SEED = 3, 2


@pytest.fixture(scope="module")
def env():
    made = gym.make(ur_like.ENV_ID)
    yield made
    made.close()


def by_hand(joints):
    """Pose (4, 4) of the flange from the published Denavit–Hartenberg figures."""
    pose = np.diag([-1.0, -1.0, 1.0, 1.0])
    for q, (d, a, alpha) in zip(joints, ur_like.DH, strict=True):
        c, s, ca, sa = np.cos(q), np.sin(q), np.cos(alpha), np.sin(alpha)
        pose = pose @ [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
    return pose


def test_physics_planner_and_data_sheet_agree(env):
    robot = env.unwrapped.planner_robot
    env.reset(seed=0)
    world = env.unwrapped.world
    rng = np.random.default_rng(0)
    for joints in rng.uniform(robot.arm.lower, robot.arm.upper, (20, 6)):
        world.set_robot(joints, 0.02)
        flange = by_hand(joints)
        np.testing.assert_allclose(world.gripper_pose[4:], flange[:3, 3] + 0.125 * flange[:3, 2], atol=1e-9)
        planned = np.asarray(forward_kinematics(robot.arm, joints)[-1])
        assert max(pose_errors(planned, world.gripper_pose)) < 1e-6
    assert (float(robot.gripper.lower), float(robot.gripper.upper)) == env.unwrapped.scenario.robot.theta_range
    assert float(robot.gripper.max_opening) == pytest.approx(2 * ur_like.UR.theta_range[1])


def test_it_is_an_environment_like_the_others(env):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*Box (observation|action) space.*")
        warnings.filterwarnings("ignore", message=".*symmetric and normalized.*")
        check_env(env.unwrapped, skip_render_check=True)
    assert env.action_space.shape == (7,)
    assert env.observation_space["observation"].shape == (2 * 6 + 18 + 8 * 11,)
    for arguments in ({"control_mode": "ee_delta"}, {"obs_type": "pixels_agent_pos", "image_size": (64, 64)}):
        other = gym.make(ur_like.ENV_ID, **arguments)
        obs, _ = other.reset(seed=0)
        assert other.observation_space.contains(obs)
        other.step(other.action_space.sample())
        other.close()


def test_gymnasium_finds_it_by_its_module():
    """As the commands are told about it: ``--env ur_like:third_party/URYCB-v0``."""
    code = f"import gymnasium; print(gymnasium.make('ur_like:{ur_like.ENV_ID}').unwrapped.planner_robot.name)"
    here = Path(ur_like.__file__).parent
    done = subprocess.run([sys.executable, "-c", code], cwd=here, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "ur"


def test_it_follows_its_commands_and_holds_still(env):
    env.reset(seed=0)
    world, command = env.unwrapped.world, env.unwrapped.command
    for _ in range(20):
        env.step(command)
    assert np.abs(world.joint_positions - ur_like.UR.home).max() < 1e-3
    command[:6] += [0.4, -0.2, 0.2, 0.4, -0.4, 0.4]
    command[6] = 0.01
    for _ in range(30):
        env.step(command)
    np.testing.assert_allclose(world.joint_positions, command[:6], atol=2e-3)
    assert world.theta == pytest.approx(0.01, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "strategy", "stages"), [(DIRECT_SEED, "direct", 1), (REGRASP_SEED, "static", 2)])
def test_the_expert_solves_its_scenes(env, seed, strategy, stages):
    record = run_episode(env, regrasp_gym.PlannerExpert(env, strategy=strategy), seed)
    assert record["success"], record["detail"]
    assert len(record["stages"]) == stages
