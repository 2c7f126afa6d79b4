"""Saved states, and the planner's view of the present one."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scenario_facts import CONTROL_MODES, SCENARIOS, assert_equal, nudged, still

from regrasp_gym.envs.reward import pose_errors
from regrasp_gym.errors import StateError

# Saved states -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("control_mode", CONTROL_MODES)
def test_restored_states_go_on_to_the_last_bit(facts, control_mode):
    env, other = facts.make(control_mode=control_mode), facts.make(control_mode=control_mode)
    env.action_space.seed(0)
    env.reset(seed=4)
    # Move into contact: down among the objects.
    for _ in range(15):
        env.step(env.action_space.sample())
    saved = env.unwrapped.get_state()
    actions = [env.action_space.sample() for _ in range(20)]

    def future(one):
        obs = one.unwrapped.set_state(saved)
        return [obs, *[one.step(action)[:2] for action in actions], one.reset()[0]]

    expected = future(env)
    other.reset(seed=99)
    other.step(still(other))
    for one in (env, other):
        got = future(one)
        for a, b in zip(expected, got, strict=True):
            if isinstance(a, tuple):
                assert_equal(a[0], b[0])
                assert a[1] == b[1]
            else:
                assert_equal(a, b)


def test_saved_states_do_not_change_with_the_environment(env):
    env.reset(seed=0)
    saved = env.unwrapped.get_state()
    physics, command = saved.physics.copy(), saved.command.copy()
    goal = nudged(env, 0.1)
    for _ in range(3):
        env.step(goal)
    assert_equal(saved.physics, physics)
    assert_equal(saved.command, command)
    assert env.unwrapped.elapsed == 3
    env.unwrapped.set_state(saved)
    assert env.unwrapped.elapsed == 0


def test_wrong_states_are_refused(facts, env):
    env.reset(seed=0)
    with pytest.raises(StateError, match="ndarray"):
        env.unwrapped.set_state(np.zeros(3))
    other = next(other for other in SCENARIOS if other.joints != facts.joints).make()
    other.reset(seed=0)
    with pytest.raises(StateError, match="another robot"):
        env.unwrapped.set_state(other.unwrapped.get_state())


# Planner ------------------------------------------------------------------------------------------------------------


def test_the_task_is_the_present_state(facts, env):
    env.reset(seed=2)
    unwrapped = env.unwrapped
    scene = unwrapped.scene
    task = unwrapped.task()
    assert task.target.name == scene.target.name
    assert max(pose_errors(task.pick.target_pose, scene.target.pose)) < 1e-9
    np.testing.assert_array_equal(task.place.target_pose, scene.goal_pose)
    np.testing.assert_array_equal(task.start, unwrapped.world.joint_positions)
    expected = {fixture.name for fixture in scene.fixtures} | {thing.name for thing in scene.others}
    for side in (task.pick, task.place):
        assert {obstacle.body.name for obstacle in side.obstacles} == expected
    assert task.supports == facts.supports
    name = scene.others[0].name
    elsewhere = np.array([1, 0, 0, 0, 0.7, 0.1, 0.2])
    unwrapped.world.set_object_pose(name, elsewhere)
    moved = {obstacle.body.name: obstacle.pose for obstacle in unwrapped.task().pick.obstacles}
    np.testing.assert_allclose(moved[name], elsewhere)


def test_fixture_bodies_are_the_simulated_boxes(env):
    from jaxlie import SE3

    env.reset(seed=2)
    model, data = env.unwrapped.world.model, env.unwrapped.world.data
    bodies = {obstacle.body.name: obstacle for obstacle in env.unwrapped.task().pick.obstacles}
    for fixture in env.unwrapped.scene.fixtures:
        obstacle, geom = bodies[fixture.name], model.geom(fixture.name)
        corners = np.array(list(itertools.product((-1, 1), repeat=3))) * geom.size
        corners = corners @ data.geom_xmat[geom.id].reshape(3, 3).T + data.geom_xpos[geom.id]
        planner = np.asarray(obstacle.body.hull_vertices()) @ np.asarray(
            SE3(obstacle.pose).rotation().as_matrix()
        ).T + np.asarray(obstacle.pose[4:])
        np.testing.assert_allclose(planner.max(axis=0), corners.max(axis=0), atol=1e-9)
        np.testing.assert_allclose(planner.min(axis=0), corners.min(axis=0), atol=1e-9)


def test_the_planner_robot_is_the_simulated_one(facts, env):
    from regrasp_planner.robot.kinematics import forward_kinematics

    robot = env.unwrapped.planner_robot
    assert facts.make().unwrapped.planner_robot is robot
    env.reset(seed=0)
    goal = nudged(env, 0.1)
    for _ in range(20):
        env.step(goal)
    world = env.unwrapped.world
    pose = np.asarray(forward_kinematics(robot.arm, world.joint_positions)[-1])
    distance, angle = pose_errors(pose, world.gripper_pose)
    assert distance < 1e-6
    assert angle < 1e-6
