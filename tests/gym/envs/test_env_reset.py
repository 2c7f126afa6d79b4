"""How an episode starts: the scene that was asked for, to the last bit, and everything at rest."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from scenario_facts import CONTROL_MODES, OBS_TYPES, assert_equal, still

from regrasp_gym.envs.reward import pose_errors
from regrasp_gym.errors import OptionError, SceneError
from regrasp_gym.scenes.scene import PlacedObject, Scene


@pytest.mark.parametrize(("obs_type", "control_mode"), list(itertools.product(OBS_TYPES, CONTROL_MODES)))
def test_two_resets_are_equal_to_the_last_bit_whatever_happened_between(facts, obs_type, control_mode):
    env = facts.make(obs_type=obs_type, control_mode=control_mode)
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


def test_scene_options(facts, env):
    by_seed, info = env.reset(seed=8)
    assert info["scene_seed"] == 8
    by_option, info = env.reset(seed=1, options={"scene": 8})
    assert info["scene_seed"] == 8
    assert_equal(by_seed, by_option)
    assert_equal(by_seed, env.reset(options={"scene": facts.scene(8)})[0])
    scene = env.unwrapped.scene
    assert info["target"] == scene.target.name
    assert info["instruction"] == scene.instruction == env.unwrapped.task_description
    assert info["instruction"].startswith(f"put the {scene.target.model.label} ")


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


@dataclasses.dataclass(frozen=True, eq=False)
class OwnScene(Scene):
    """A scene with the objects that a test gives it."""

    objects: tuple[PlacedObject, ...]

    @property
    def others(self):
        return self.objects

    @property
    def instruction(self):
        return "put the target at its goal"


def with_others(scene, others):
    """The scene with other objects around the target."""
    fields = {field.name: getattr(scene, field.name) for field in dataclasses.fields(Scene)}
    return OwnScene(**fields, objects=tuple(others))


def test_a_scene_with_the_same_object_twice_is_refused(facts, env):
    scene = facts.scene(0)
    above = PlacedObject(scene.target.model, scene.target.pose + np.array([0, 0, 0, 0, 0, 0, 2.0]))
    with pytest.raises(SceneError, match=scene.target.name):
        env.reset(options={"scene": with_others(scene, [above])})


def test_a_scene_with_more_objects_than_there_is_room_for_is_refused(facts, env):
    scene, room = facts.scene(0), facts.scenario.max_others
    model = scene.target.model
    more = [PlacedObject(dataclasses.replace(model, name=f"more_{k}"), scene.target.pose) for k in range(room + 1)]
    with pytest.raises(OptionError, match=f"{room + 1} objects .* room for {room}"):
        env.reset(options={"scene": with_others(scene, more)})


def test_scene_config_is_used(facts):
    env = facts.make(scene_config=facts.bare)
    room = 11 * facts.scenario.max_others
    for seed in range(3):
        obs, _ = env.reset(seed=seed)
        assert env.unwrapped.scene.config == facts.bare
        assert not obs["observation"][-room:].any()


def test_everything_is_at_rest_at_the_start(facts, env):
    for seed in range(14):
        env.reset(seed=seed)
        world = env.unwrapped.world
        start = np.vstack([world.target_pose, world.other_poses])
        home = world.joint_positions.copy()
        for _ in range(20):
            obs, *_ = env.step(still(env))
        distance, angle = pose_errors(start, np.vstack([world.target_pose, world.other_poses]))
        # A millimetre for what is held by 25 mm.
        assert distance.max() < facts.scenario.tolerance.position / 25
        assert angle.max() < np.deg2rad(1)
        assert np.abs(world.joint_positions - home).max() < 1e-3
        assert obs["achieved_goal"][7] == 0
        # Nothing is inside anything else.
        assert world.data.contact.dist.min() > -facts.scenario.tolerance.position / 50
