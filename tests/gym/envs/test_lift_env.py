"""The lifting task: its contract, what counts as success, and the expert's plan for it."""

from __future__ import annotations

import re

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from scripted_lift import LIFT, ScriptedLift

import regrasp_gym
from regrasp_bench.tables.episodes import run_episode
from regrasp_gym.envs.observation import agent_layout, environment_layout, size, state_layout
from regrasp_gym.envs.panda_lift import PandaYCBLiftEnv
from regrasp_gym.errors import SceneError, StateError
from regrasp_gym.scenes.lift import LiftConfig, make_scene
from regrasp_planner import StrategyError


@pytest.fixture(scope="module")
def env():
    made = gym.make(LIFT, control_mode="ee_delta")
    yield made
    made.close()


def lifted(env, seed):
    """An episode of the scripted expert: every observation, and the last info."""
    observation, info = env.reset(seed=seed)
    expert, seen = ScriptedLift(env), [observation]
    expert.reset()
    while (action := expert.act()) is not None:
        observation, reward, _, truncated, info = env.step(action)
        seen.append(observation)
        assert not truncated
        assert (reward == 0) == info["is_success"]
    return seen, info


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("obs_type", ["state", "pixels_agent_pos"])
@pytest.mark.parametrize("control_mode", ["joint_pos", "ee_delta"])
def test_gymnasium_check_env(obs_type, control_mode):
    made = gym.make(LIFT, obs_type=obs_type, control_mode=control_mode, image_size=(64, 64))
    check_env(made.unwrapped, skip_render_check=True)
    made.close()


def test_scenes_depend_on_the_seed_alone(env):
    a, _ = env.reset(seed=5)
    env.step(env.action_space.sample())
    env.reset(seed=6)
    b, _ = env.reset(seed=5)
    for key in a:
        np.testing.assert_array_equal(a[key], b[key])
    scene = make_scene(5)
    np.testing.assert_allclose(scene.goal_pose - scene.target.pose, [0, 0, 0, 0, 0, 0, 0.1])
    assert env.unwrapped.task_description == "lift the foam brick by 10 cm"


def test_lifting_succeeds_and_lying_does_not(env):
    seen, info = lifted(env, 1)
    assert info["is_success"]
    first, last = seen[0], seen[-1]
    np.testing.assert_array_equal(first["desired_goal"], last["desired_goal"])
    assert first["achieved_goal"][7] == 1
    np.testing.assert_array_equal(last["achieved_goal"][7:9], [0, 1])
    assert last["achieved_goal"][6] - first["achieved_goal"][6] > 0.07


def test_a_target_in_the_air_that_nothing_holds_is_no_success(env):
    env.reset(seed=2)
    inner = env.unwrapped
    inner.world.set_object_pose(inner.scene.target.name, inner.scene.goal_pose)
    assert not inner.is_success


def test_relabelled_goals_are_reached(env):
    """What hindsight experience replay needs: every achieved goal is a success for itself, held or lying."""
    seen, _ = lifted(env, 3)
    achieved = np.array([observation["achieved_goal"] for observation in seen])
    np.testing.assert_array_equal(env.unwrapped.compute_reward(achieved, achieved, [{}]), 0.0)
    goal = np.tile(seen[0]["desired_goal"], (len(achieved), 1))
    reward = env.unwrapped.compute_reward(achieved, goal, [{}])
    assert reward[-1] == 0
    assert (reward[:20] == -1).all()


@pytest.mark.parametrize(
    ("name", "layout"),
    [
        ("observation", state_layout(7, 0)),
        ("agent_pos", agent_layout(7)),
        ("environment_state", environment_layout(0)),
    ],
)
def test_docstring_lists_exactly_what_there_is(name, layout):
    text = " ".join(PandaYCBLiftEnv.__doc__.split())
    listed = re.match(r" \((\d+),\):([^.;]*)", text.split(f"``{name}``")[1])
    assert re.findall(r"([a-z ]+) (\d+) \(", listed[2].replace(",", "")) == [
        (f" {part}", str(count)) for part, count in layout if count
    ]
    assert int(listed[1]) == size(layout)


def test_states_with_more_objects_are_refused(env):
    full = gym.make("regrasp_gym/PandaYCB-v0")
    full.reset(seed=0)
    env.reset(seed=0)
    scene = env.unwrapped.scene
    with pytest.raises(StateError, match="objects besides the target"):
        env.unwrapped.set_state(full.unwrapped.get_state())
    assert env.unwrapped.scene is scene
    full.close()


def test_unknown_strategies_are_named(env):
    env.reset(seed=0)
    with pytest.raises(StrategyError, match=r"'clever'.*direct"):
        env.unwrapped.plan("clever")


def test_wrong_configs_are_named():
    with pytest.raises(SceneError, match="unknown name 'brick'"):
        LiftConfig(targets=("brick",))
    with pytest.raises(SceneError, match="025_mug"):
        LiftConfig(targets=("025_mug",), max_opening=0.02)
    with pytest.raises(SceneError, match="height"):
        LiftConfig(height=0.0)
    with pytest.raises(SceneError, match="negative"):
        make_scene(-1)


@pytest.mark.slow
@pytest.mark.parametrize("control_mode", ["joint_pos", "ee_delta"])
def test_the_planners_expert_lifts(control_mode):
    made = gym.make(LIFT, control_mode=control_mode)
    expert = regrasp_gym.PlannerExpert(made)
    for seed in range(3):
        record = run_episode(made, expert, seed)
        assert record["success"], record["detail"]
        assert len(record["stages"]) == 1
    made.close()
