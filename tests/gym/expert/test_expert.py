"""The expert in the simulation: what it plans holds by friction, and where it cannot go on it says why."""

import gymnasium as gym
import numpy as np
import pytest
from scenario_facts import EXCAVATOR, PANDA

import regrasp_gym
from regrasp_gym.errors import OptionError
from regrasp_planner import Reason, SegmentKind


def run(env, expert, seed, interfere=lambda expert: None):
    env.reset(seed=seed)
    assert expert.reset(), expert.failure
    actions, info = [], {}
    while (action := expert.act()) is not None:
        assert env.action_space.contains(action)
        *_, truncated, info = env.step(action)
        actions.append(action)
        assert not truncated
        interfere(expert)
    return np.array(actions), info


def test_one_grasp_is_executed_by_friction(facts, env):
    expert = regrasp_gym.PlannerExpert(env)
    actions, info = run(env, expert, facts.direct_seed)
    assert info["is_success"], expert.failure
    assert expert.failure is None
    assert expert.stage_index == len(expert.plan.stages) == 1
    again, _ = run(env, expert, facts.direct_seed)
    np.testing.assert_array_equal(actions, again)


def test_a_regrasp_is_executed_by_friction(facts, env):
    expert = regrasp_gym.PlannerExpert(env)
    seen = []

    def watch(expert):
        if expert.segment is not None and expert.segment.kind not in seen[-1:]:
            seen.append(expert.segment.kind)

    _, info = run(env, expert, facts.regrasp_seed, watch)
    assert info["is_success"], expert.failure
    assert len(expert.plan.stages) == 2
    assert expert.stage_index == 2
    # The rest was planned anew from where the target came to rest.
    assert len(expert.plans) == 2
    assert seen.count(SegmentKind.CLOSE) == seen.count(SegmentKind.OPEN) == 2


@pytest.mark.parametrize(
    "facts", [PANDA, pytest.param(EXCAVATOR, marks=pytest.mark.slow)], ids=lambda facts: facts.name
)
def test_the_expert_acts_through_gripper_moves_too(facts):
    env = facts.make(control_mode="ee_delta")
    expert = regrasp_gym.PlannerExpert(env)
    _, info = run(env, expert, facts.direct_seed)
    assert info["is_success"], expert.failure
    env.close()


def test_a_lost_target_is_noticed(facts, env):
    expert = regrasp_gym.PlannerExpert(env)
    inner = env.unwrapped

    def steal(expert):
        if expert.segment is not None and expert.segment.kind is SegmentKind.TRANSFER:
            pose = inner.world.target_pose.copy()
            pose[4:] = facts.out_of_reach
            inner.world.set_object_pose(inner.scene.target.name, pose)

    _, info = run(env, expert, facts.direct_seed, steal)
    assert not info["is_success"]
    assert expert.failure.reason in (Reason.LOST_GRASP, Reason.SETTLED_ELSEWHERE)
    assert expert.failure.message
    assert expert.act() is None


def test_other_environments_are_refused():
    with pytest.raises(OptionError, match="PlannerExpert needs an environment of regrasp_gym"):
        regrasp_gym.PlannerExpert(gym.make("CartPole-v1"))


def test_nothing_to_show_before_reset(env):
    with pytest.raises(OptionError, match=r"reset\(\)"):
        _ = regrasp_gym.PlannerExpert(env).plan
