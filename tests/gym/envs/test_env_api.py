"""Gymnasium's contract, and what the environments add to it: rates, argument checks, actions."""

from __future__ import annotations

import gc
import itertools
import subprocess
import sys
import warnings

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from scenario_facts import CONTROL_MODES, OBS_TYPES, SCENARIOS, assert_equal, nudged, still

from regrasp_gym.envs import observation
from regrasp_gym.errors import ActionError, OptionError

COMBINATIONS = list(itertools.product(OBS_TYPES, CONTROL_MODES))


# Contract -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("obs_type", "control_mode"), COMBINATIONS)
@pytest.mark.parametrize("reward_type", ["sparse", "dense"])
def test_gymnasium_check_env(facts, obs_type, control_mode, reward_type):
    env = facts.make(obs_type=obs_type, control_mode=control_mode, reward_type=reward_type)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Unbounded vectors and joint limits that are not ±1 are as they should be.
        warnings.filterwarnings("ignore", message=".*Box (observation|action) space.*")
        warnings.filterwarnings("ignore", message=".*symmetric and normalized.*")
        check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_it_renders(facts):
    env = facts.make(render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (480, 640, 3)
    assert picture.std() > 10
    env.close()


def test_an_environment_dropped_unclosed_leaves_the_pictures_of_others_alone(facts):
    def seen(env):
        return env.unwrapped.set_state(env.unwrapped.get_state())["pixels"][facts.scenario.pixels[0]]

    dropped, kept = (facts.make(obs_type="pixels_agent_pos", image_size=(64, 64)) for _ in range(2))
    for env in (dropped, kept):
        env.reset(seed=0)
    before = seen(kept)
    del env, dropped
    gc.collect()
    np.testing.assert_array_equal(seen(kept), before)
    kept.close()


@pytest.mark.rl
@pytest.mark.parametrize(("obs_type", "control_mode"), COMBINATIONS)
def test_stable_baselines_check_env(facts, obs_type, control_mode):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = facts.make(obs_type=obs_type, control_mode=control_mode)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        checker.check_env(env)
    env.close()


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_vectorised(facts, mode):
    options = {} if mode == "sync" else {"vector_kwargs": {"context": "spawn"}}
    envs = gym.make_vec(facts.env_id, num_envs=2, vectorization_mode=mode, **options)
    obs, info = envs.reset(seed=[3, 4])
    assert obs["observation"].shape == (2, observation.size(facts.layouts["observation"]))
    assert list(info["scene_seed"]) == [3, 4]
    single = facts.make()
    assert_equal(single.reset(seed=4)[0], {key: value[1] for key, value in obs.items()})
    action = still(single)
    obs, reward, *_ = envs.step(np.stack([action, action]))
    assert_equal(single.step(action)[0], {key: value[1] for key, value in obs.items()})
    np.testing.assert_array_equal(reward, [-1, -1])
    envs.close()


def test_time_limit_and_rates(facts, env):
    assert env.spec.max_episode_steps == facts.steps
    env.reset(seed=0)
    data, model = env.unwrapped.world.data, env.unwrapped.world.model
    before = data.time
    env.step(still(env))
    period = facts.scenario.control_period
    assert data.time - before == pytest.approx(period)
    assert model.opt.timestep <= 1 / 500
    assert env.metadata["render_fps"] == round(1 / period)


@pytest.mark.parametrize("name", ["obs_type", "control_mode", "reward_type", "render_mode"])
def test_unknown_arguments_are_named(facts, name):
    with pytest.raises(OptionError, match=f"{name}='nonsense'"):
        facts.env_class(**{name: "nonsense"})


def test_stepping_before_reset_is_refused(facts):
    with pytest.raises(gym.error.ResetNeeded):
        facts.make().unwrapped.step(np.zeros(facts.joints + 1))


def test_stepping_loads_neither_the_planner_nor_learning_libraries():
    code = (
        "import sys, gymnasium, regrasp_gym\n"
        "for name in sys.argv[1:]:\n"
        "    e = gymnasium.make(name); e.reset(seed=0); e.step(e.action_space.sample())\n"
        "print(*[m for m in ('jax', 'torch', 'lerobot', 'stable_baselines3') if m in sys.modules])"
    )
    command = [sys.executable, "-c", code, *(facts.env_id for facts in SCENARIOS)]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip() == ""


def test_only_goal_observations_make_a_goal_environment(facts):
    pixels = facts.make(obs_type="pixels_agent_pos")
    for env in (pixels, pixels.unwrapped):
        assert not hasattr(env, "compute_reward")
    state = facts.make()
    for env in (state, state.unwrapped):
        assert hasattr(env, "compute_reward")
    pixels.close()
    state.close()


def test_the_model_has_what_the_documentation_promises(facts, env):
    env.reset(seed=0)
    model = env.unwrapped.world.model
    for camera in facts.cameras:
        assert mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera) >= 0
        assert f"`{camera}`" in facts.env_class.__doc__ or f'`"{camera}"`' in facts.env_class.__doc__


# Actions ------------------------------------------------------------------------------------------------------------


def test_joints_follow_their_commands(facts, env):
    env.reset(seed=0)
    goal, n = nudged(env, 0.15), facts.joints
    low, high = facts.scenario.robot.theta_range
    goal[n] = low + (high - low) / 4
    for _ in range(30):
        obs, *_ = env.step(goal)
    np.testing.assert_allclose(obs["observation"][:n], goal[:n], atol=0.01)
    assert obs["observation"][2 * n] == pytest.approx(goal[n], abs=0.025 * (high - low))


def test_the_gripper_follows_deltas(facts):
    env = facts.make(control_mode="ee_delta")
    n, step = facts.joints, facts.scenario.translation_step
    obs, _ = env.reset(seed=0)
    at = slice(2 * n + 6, 2 * n + 9)
    start = obs["observation"][at]
    for _ in range(16):
        obs, *_ = env.step(np.array([0, 0, -0.25, 0, 0, 0, 1.0]))
    for _ in range(5):
        obs, *_ = env.step(np.array([0, 0, 0, 0, 0, 0, 1.0]))
    np.testing.assert_allclose(obs["observation"][at] - start, [0, 0, -4 * step], atol=0.15 * step)


@pytest.mark.parametrize("control_mode", CONTROL_MODES)
def test_out_of_range_actions_act_as_clipped(facts, control_mode):
    env = facts.make(control_mode=control_mode)
    env.reset(seed=0)
    space = env.action_space
    wild = space.high + 3.0
    a = env.step(wild)[0]
    env.reset(seed=0)
    assert_equal(a, env.step(space.high)[0])


@pytest.mark.parametrize("control_mode", CONTROL_MODES)
def test_bad_actions_raise_and_change_nothing(facts, control_mode):
    env = facts.make(control_mode=control_mode)
    env.reset(seed=0)
    before = env.unwrapped.get_state()
    size = env.action_space.shape[0]
    bad = still(env).copy()
    bad[2] = np.nan
    for action, message in ((np.zeros(size + 1), "shape"), (bad, r"action\[2\] is nan"), ("left", "not an array")):
        with pytest.raises(ActionError, match=message):
            env.unwrapped.step(action)
    assert_equal(before.physics, env.unwrapped.get_state().physics)


def test_returned_observations_are_copies(env):
    obs, _ = env.reset(seed=0)
    kept = {key: value.copy() for key, value in obs.items()}
    env.step(nudged(env, 0.05))
    assert_equal(obs, kept)
