from __future__ import annotations

import itertools
import subprocess
import sys
import time
import warnings

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from scipy.spatial.transform import Rotation

import regrasp_gym  # noqa: F401  registers the environments
from regrasp_gym.envs.panda_ycb import PandaYCBEnv
from regrasp_gym.errors import ActionError, OptionError, SceneError, StateError
from regrasp_gym.reward import pose_errors
from regrasp_gym.scenes.scene import PlacedObject
from regrasp_gym.scenes.table_shelf import TableShelfConfig, TableShelfScene, make_scene

ENV_ID = "regrasp_gym/PandaYCB-v0"
OBS_TYPES = ("state", "pixels_agent_pos")
CONTROL_MODES = ("joint_pos", "ee_delta")
COMBINATIONS = list(itertools.product(OBS_TYPES, CONTROL_MODES))


def make(**arguments):
    return gym.make(ENV_ID, **arguments)


@pytest.fixture(scope="module")
def env():
    made = make()
    yield made
    made.close()


def assert_equal(a, b):
    """Equal to the last bit, through dictionaries."""
    if isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            assert_equal(a[key], b[key])
    else:
        np.testing.assert_array_equal(a, b)


def still(env):
    """The action that keeps the commanded position."""
    return env.unwrapped.command.astype(np.float32) if env.action_space.shape == (8,) else np.eye(7)[6]


# Gymnasium's contract -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("obs_type", "control_mode"), COMBINATIONS)
@pytest.mark.parametrize("reward_type", ["sparse", "dense"])
def test_gymnasium_check_env(obs_type, control_mode, reward_type):
    env = make(obs_type=obs_type, control_mode=control_mode, reward_type=reward_type, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Unbounded vectors and joint limits that are not ±1 are as they should be.
        warnings.filterwarnings("ignore", message=".*Box (observation|action) space.*")
        warnings.filterwarnings("ignore", message=".*symmetric and normalized.*")
        check_env(env.unwrapped, skip_render_check=True)
    assert env.unwrapped.render().shape == (480, 640, 3)
    env.close()


@pytest.mark.rl
@pytest.mark.parametrize(("obs_type", "control_mode"), COMBINATIONS)
def test_stable_baselines_check_env(obs_type, control_mode):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = make(obs_type=obs_type, control_mode=control_mode)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        checker.check_env(env)
    env.close()


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_vectorised(mode):
    options = {} if mode == "sync" else {"vector_kwargs": {"context": "spawn"}}
    envs = gym.make_vec(ENV_ID, num_envs=2, vectorization_mode=mode, **options)
    obs, info = envs.reset(seed=[3, 4])
    assert obs["observation"].shape == (2, 120)
    assert list(info["scene_seed"]) == [3, 4]
    single = make()
    assert_equal(single.reset(seed=4)[0], {key: value[1] for key, value in obs.items()})
    action = still(single)
    obs, reward, *_ = envs.step(np.stack([action, action]))
    assert_equal(single.step(action)[0], {key: value[1] for key, value in obs.items()})
    np.testing.assert_array_equal(reward, [-1, -1])
    envs.close()


def test_time_limit_and_rates():
    env = make()
    assert env.spec.max_episode_steps == 1000
    env.reset(seed=0)
    data, model = env.unwrapped.world.data, env.unwrapped.world.model
    before = data.time
    env.step(still(env))
    assert data.time - before == pytest.approx(0.05)
    assert model.opt.timestep <= 1 / 500
    assert env.metadata["render_fps"] == 20


@pytest.mark.parametrize("name", ["obs_type", "control_mode", "reward_type", "render_mode"])
def test_unknown_arguments_are_named(name):
    with pytest.raises(OptionError, match=f"{name}='nonsense'"):
        PandaYCBEnv(**{name: "nonsense"})


def test_stepping_before_reset_is_refused(env):
    with pytest.raises(gym.error.ResetNeeded):
        make().unwrapped.step(np.zeros(8))


def test_stepping_loads_neither_the_planner_nor_learning_libraries():
    code = (
        "import sys, gymnasium, regrasp_gym; e = gymnasium.make('regrasp_gym/PandaYCB-v0'); e.reset(seed=0);"
        "e.step(e.action_space.sample());"
        "print(*[m for m in ('jax', 'torch', 'lerobot', 'stable_baselines3') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


# Reset --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("obs_type", "control_mode"), COMBINATIONS)
def test_two_resets_are_equal_to_the_last_bit_whatever_happened_between(obs_type, control_mode):
    env = make(obs_type=obs_type, control_mode=control_mode)
    rng = np.random.default_rng(0)
    low, high = env.action_space.low, env.action_space.high
    actions = rng.uniform(low, high, (5, *low.shape)).astype(np.float32)

    def episode():
        yield env.reset(seed=5)[0]
        yield env.unwrapped.get_state().physics
        for action in actions:
            yield env.step(action)[0]
            yield env.unwrapped.get_state().physics

    first = list(episode())
    second = list(episode())
    saved = env.unwrapped.get_state()
    env.reset(seed=6)
    for _ in range(10):
        env.step(env.action_space.sample())
    env.unwrapped.set_state(saved)
    env.step(actions[0])
    third = list(episode())
    for a, b, c in zip(first, second, third, strict=True):
        assert_equal(a, b)
        assert_equal(a, c)
    env.close()


def test_resets_without_a_seed_go_on_from_the_last_seed(env):
    def seeds():
        env.reset(seed=1)
        return [env.reset()[1]["scene_seed"] for _ in range(4)]

    first = seeds()
    assert len(set(first)) == 4
    assert seeds() == first


def test_scene_options(env):
    by_seed, info = env.reset(seed=8)
    assert info["scene_seed"] == 8
    by_option, info = env.reset(seed=1, options={"scene": 8})
    assert info["scene_seed"] == 8
    assert_equal(by_seed, by_option)
    assert_equal(by_seed, env.reset(options={"scene": make_scene(8)})[0])
    assert info["instruction"] == env.unwrapped.task_description
    assert info["instruction"] == f"put the {env.unwrapped.scene.target.model.label} upright on the shelf"


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"scenes": 1}, OptionError, "unknown reset option 'scenes'"),
        ({"scene": "table"}, OptionError, "'table'"),
        ({"scene": True}, OptionError, "True"),
        ({"scene": -3}, SceneError, "-3"),
    ],
)
def test_bad_options_are_named(env, options, error, message):
    with pytest.raises(error, match=message):
        env.reset(seed=0, options=options)


def test_a_scene_with_the_same_object_twice_is_refused(env):
    scene = make_scene(0)
    twice = TableShelfScene(
        scene.seed,
        scene.config,
        scene.target,
        scene.goal_pose,
        (PlacedObject(scene.target.model, scene.target.pose + np.array([0, 0, 0, 0, 0, 0, 0.5])),),
        (),
        scene.fixtures,
        scene.release,
    )
    with pytest.raises(SceneError, match=scene.target.name):
        env.reset(options={"scene": twice})


def test_scene_config_is_used():
    env = make(scene_config=TableShelfConfig(targets=("077_rubiks_cube",), table_clutter=(0, 0), shelf_clutter=(0, 0)))
    for seed in range(3):
        obs, info = env.reset(seed=seed)
        assert info["target"] == "077_rubiks_cube"
        assert not obs["observation"][32:].any()


def test_reset_is_fast(env):
    for seed in range(5):
        env.reset(seed=seed)
    took = []
    for seed in range(100, 120):
        start = time.process_time()
        env.reset(seed=seed)
        took.append(time.process_time() - start)
    assert np.median(took) < 0.05


def test_everything_is_at_rest_at_the_start(env):
    for seed in range(25):
        env.reset(seed=seed)
        world = env.unwrapped.world
        start = np.vstack([world.target_pose, world.other_poses])
        home = world.joint_positions.copy()
        for _ in range(20):
            obs, *_ = env.step(still(env))
        distance, angle = pose_errors(start, np.vstack([world.target_pose, world.other_poses]))
        assert distance.max() < 1e-3
        assert angle.max() < np.deg2rad(1)
        assert np.abs(world.joint_positions - home).max() < 1e-3
        assert obs["achieved_goal"][7] == 0
        # Nothing is inside anything else.
        assert world.data.contact.dist.min() > -5e-4


# Step ---------------------------------------------------------------------------------------------------------------


def test_joints_follow_their_commands(env):
    env.reset(seed=0)
    goal = env.unwrapped.command
    goal[:7] += [0.3, -0.2, 0.1, 0.2, -0.3, 0.2, 0.4]
    goal[7] = 0.01
    for _ in range(30):
        obs, *_ = env.step(goal)
    np.testing.assert_allclose(obs["observation"][:7], goal[:7], atol=0.01)
    assert obs["observation"][14] == pytest.approx(0.01, abs=1e-3)


def test_the_gripper_follows_deltas():
    env = make(control_mode="ee_delta")
    obs, _ = env.reset(seed=0)
    start = obs["observation"][20:23]
    for _ in range(8):
        obs, *_ = env.step(np.array([0, 0, -0.5, 0, 0, 0, 1.0]))
    for _ in range(5):
        obs, *_ = env.step(np.array([0, 0, 0, 0, 0, 0, 1.0]))
    np.testing.assert_allclose(obs["observation"][20:23] - start, [0, 0, -0.08], atol=3e-3)


@pytest.mark.parametrize("control_mode", CONTROL_MODES)
def test_out_of_range_actions_act_as_clipped(control_mode):
    env = make(control_mode=control_mode)
    env.reset(seed=0)
    space = env.action_space
    wild = space.high + 3.0
    a = env.step(wild)[0]
    env.reset(seed=0)
    assert_equal(a, env.step(space.high)[0])


@pytest.mark.parametrize("control_mode", CONTROL_MODES)
def test_bad_actions_raise_and_change_nothing(control_mode):
    env = make(control_mode=control_mode)
    env.reset(seed=0)
    before = env.unwrapped.get_state()
    size = env.action_space.shape[0]
    bad = still(env).copy()
    bad[2] = np.nan
    for action, message in ((np.zeros(size + 1), "shape"), (bad, r"action\[2\] is nan"), ("left", "no array")):
        with pytest.raises(ActionError, match=message):
            env.unwrapped.step(action)
    assert_equal(before.physics, env.unwrapped.get_state().physics)


def test_returned_observations_are_copies(env):
    obs, _ = env.reset(seed=0)
    kept = {key: value.copy() for key, value in obs.items()}
    goal = env.unwrapped.command
    goal[0] += 0.1
    env.step(goal)
    assert_equal(obs, kept)


# Success and reward -------------------------------------------------------------------------------------------------


def at_goal(env, change=None):
    """Put the target at its goal, changed by ``change``, and look after one step."""
    env.reset(seed=3)
    unwrapped = env.unwrapped
    pose = np.array(unwrapped.scene.goal_pose)
    if change is not None:
        pose = change(pose)
    unwrapped.world.set_object_pose(unwrapped.scene.target.name, pose)
    return env.step(still(env))


def check_agreement(env, obs, reward, info):
    assert (reward == 0) == info["is_success"]
    assert env.unwrapped.compute_reward(obs["achieved_goal"], obs["desired_goal"], {}) == reward


def turned(axis, degrees):
    def change(pose):
        turn = Rotation.from_rotvec(np.deg2rad(degrees) * np.array(axis)) * Rotation.from_quat(np.roll(pose[:4], -1))
        return np.concatenate([np.roll(turn.as_quat(), 1), pose[4:]])

    return change


def shifted(*by):
    return lambda pose: pose + np.concatenate([np.zeros(4), by])


@pytest.mark.parametrize("reward_type", ["sparse", "dense"])
def test_success_at_the_goal(reward_type):
    env = make(reward_type=reward_type)
    assert not env.reset(seed=3)[1]["is_success"]
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
    [turned([0, 0, 1], 20), turned([0, 0, 1], 180), shifted(0.03, 0, 0), shifted(0, 0, 0.06)],
    ids=["turned too far", "backwards", "beside it", "too high"],
)
def test_no_success_out_of_tolerance(env, change):
    obs, reward, _, _, info = at_goal(env, change)
    assert not info["is_success"]
    check_agreement(env, obs, reward, info)


@pytest.mark.parametrize(
    ("change", "velocity", "moving"),
    [
        (None, None, 0),
        (None, [0.05, 0, 0, 0, 0, 0], 1),
        (None, [0, 0, 0, 0, 0, 1.0], 1),
        (shifted(0, 0, 0.02), None, 1),
    ],
    ids=["at rest", "sliding", "spinning", "at the top of a throw"],
)
def test_only_what_rests_is_a_success(env, change, velocity, moving):
    env.reset(seed=3)
    unwrapped = env.unwrapped
    pose = unwrapped.scene.goal_pose if change is None else change(unwrapped.scene.goal_pose)
    unwrapped.world.set_object_pose(unwrapped.scene.target.name, pose, velocity and np.array(velocity))
    obs = unwrapped.set_state(unwrapped.get_state())
    assert obs["achieved_goal"][7] == moving
    assert unwrapped.compute_reward(obs["achieved_goal"], obs["desired_goal"], {}) == -moving


def test_no_success_for_something_resting_elsewhere(env):
    env.reset(seed=3)
    for _ in range(5):
        obs, reward, _, _, info = env.step(still(env))
        assert obs["achieved_goal"][7] == 0
        assert not info["is_success"]
        check_agreement(env, obs, reward, info)


def hold_in_the_air(env):
    """Close the gripper around the target, in the air, and keep it there."""
    env.reset(seed=3)
    unwrapped = env.unwrapped
    assert unwrapped.scene.target.name == "077_rubiks_cube"
    pose = unwrapped.world.gripper_pose
    unwrapped.world.set_object_pose("077_rubiks_cube", pose)
    action = unwrapped.command
    action[7] = 0.0
    # Hold it by hand until the fingers do.
    for _ in range(6):
        unwrapped.world.set_object_pose("077_rubiks_cube", pose)
        env.step(action)
    for _ in range(20):
        obs, reward, _, _, info = env.step(action)
    return obs, reward, info, pose


def test_a_held_target_is_touched_and_never_a_success(env):
    obs, _, info, pose = hold_in_the_air(env)
    assert np.linalg.norm(obs["achieved_goal"][4:7] - pose[4:]) < 0.01, "friction holds it"
    assert obs["achieved_goal"][8] == 1
    assert obs["achieved_goal"][7] == 1, "nothing but the gripper supports it"
    # Even if the goal were right here.
    here = np.concatenate([obs["achieved_goal"][:7], np.zeros(3)])
    assert env.unwrapped.compute_reward(obs["achieved_goal"], here, {}) == -1
    assert not info["is_success"]


def test_terminate_on_success():
    env = make(terminate_on_success=True)
    env.reset(seed=3)
    assert not env.step(still(env))[2]
    assert at_goal(env)[2] is True


def test_compute_reward_is_vectorised_and_needs_no_info(env):
    obs, *_ = at_goal(env)
    achieved = np.stack([obs["achieved_goal"], obs["achieved_goal"] + 1])
    desired = np.stack([obs["desired_goal"]] * 2)
    rewards = env.unwrapped.compute_reward(achieved, desired, [{}])
    np.testing.assert_array_equal(rewards, [0, -1])


def test_only_goal_observations_make_a_goal_environment():
    for env in (make(obs_type="pixels_agent_pos"), make(obs_type="pixels_agent_pos").unwrapped):
        assert not hasattr(env, "compute_reward")
    for env in (make(), make().unwrapped):
        assert hasattr(env, "compute_reward")


# State --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("control_mode", CONTROL_MODES)
def test_restored_states_go_on_to_the_last_bit(control_mode):
    env, other = make(control_mode=control_mode), make(control_mode=control_mode)
    env.action_space.seed(0)
    env.reset(seed=4)
    low = env.unwrapped.command
    # Move into contact: down onto the table among the objects.
    for _ in range(15):
        action = env.action_space.sample()
        env.step(action)
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
    assert low.shape == (8,)


def test_saved_states_do_not_change_with_the_environment(env):
    env.reset(seed=0)
    saved = env.unwrapped.get_state()
    physics, command = saved.physics.copy(), saved.command.copy()
    goal = command.copy()
    goal[0] += 0.2
    for _ in range(3):
        env.step(goal)
    assert_equal(saved.physics, physics)
    assert_equal(saved.command, command)
    assert env.unwrapped.elapsed == 3
    env.unwrapped.set_state(saved)
    assert env.unwrapped.elapsed == 0


def test_wrong_states_are_refused(env):
    env.reset(seed=0)
    with pytest.raises(StateError, match="ndarray"):
        env.unwrapped.set_state(np.zeros(3))


# Planner ------------------------------------------------------------------------------------------------------------


def test_the_task_is_the_present_state(env):
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
    assert task.supports == {"table", "shelf_board"}
    name = scene.others[0].name
    elsewhere = np.array([1, 0, 0, 0, 0.7, 0.1, 0.2])
    unwrapped.world.set_object_pose(name, elsewhere)
    moved = {obstacle.body.name: obstacle.pose for obstacle in unwrapped.task().pick.obstacles}
    np.testing.assert_allclose(moved[name], elsewhere)


def test_fixture_bodies_are_the_simulated_boxes(env):
    from jaxlie import SE3

    env.reset(seed=2)
    model, data = env.unwrapped.world.model, env.unwrapped.world.data
    for obstacle in env.unwrapped.task().pick.obstacles[:6]:
        geom = model.geom(obstacle.body.name)
        corners = np.array(list(itertools.product((-1, 1), repeat=3))) * geom.size
        corners = corners @ data.geom_xmat[geom.id].reshape(3, 3).T + data.geom_xpos[geom.id]
        planner = np.asarray(obstacle.body.hull_vertices()) @ np.asarray(
            SE3(obstacle.pose).rotation().as_matrix()
        ).T + np.asarray(obstacle.pose[4:])
        np.testing.assert_allclose(np.sort(planner.max(axis=0)), np.sort(corners.max(axis=0)), atol=1e-9)
        np.testing.assert_allclose(np.sort(planner.min(axis=0)), np.sort(corners.min(axis=0)), atol=1e-9)


def test_the_planner_robot_is_the_simulated_one(env):
    from regrasp_planner.robot import forward_kinematics

    robot = env.unwrapped.planner_robot
    assert make().unwrapped.planner_robot is robot
    env.reset(seed=0)
    goal = env.unwrapped.command
    goal[:7] += 0.2
    for _ in range(20):
        env.step(goal)
    world = env.unwrapped.world
    pose = np.asarray(forward_kinematics(robot.arm, world.joint_positions)[-1])
    distance, angle = pose_errors(pose, world.gripper_pose)
    assert distance < 1e-6
    assert angle < 1e-6


def test_the_model_has_what_the_documentation_promises(env):
    env.reset(seed=0)
    model = env.unwrapped.world.model
    for camera in ("front", "wrist", "overview"):
        assert mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera) >= 0
