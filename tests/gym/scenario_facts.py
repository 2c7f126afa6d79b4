"""Facts of each scenario for the environments' tests, which run for all scenarios."""

from __future__ import annotations

import dataclasses
import itertools
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

import regrasp_gym  # noqa: F401  registers the environments
from regrasp_gym.envs import observation
from regrasp_gym.envs.base import RegraspEnv
from regrasp_gym.envs.excavator_stones import EXCAVATOR_STONES, ExcavatorStonesEnv
from regrasp_gym.envs.panda_ycb import PANDA_YCB, PandaYCBEnv
from regrasp_gym.objects.model import solid
from regrasp_gym.scenes.scene import PlacedObject, Scene
from regrasp_gym.scenes.slopes_config import SlopesConfig
from regrasp_gym.scenes.table_shelf_config import TableShelfConfig
from regrasp_gym.simulation.scenario import Scenario

OBS_TYPES = ("state", "pixels_agent_pos")
CONTROL_MODES = ("joint_pos", "ee_delta")


@dataclass(frozen=True, eq=False)
class Facts:
    """One scenario.

    Attributes:
        name: Gymnasium id without namespace and version; names the test cases.
        env_class: the environment.
        scenario: the scenario.
        steps: time limit, environment steps.
        supports: fixtures that objects may rest on.
        cameras: names of all cameras.
        bare: config of scenes with nothing but the target.
        held_box: (3,) edges (metres) and mass (kilograms) of a box that fits between the open fingers.
        closing_steps: environment steps that the fingers need to close.
        out_of_reach: an unreachable point in the air, metres.
        direct_seed: a scene that needs one grasp.
        regrasp_seed: a scene that the expert solves with two grasps.
    """

    name: str
    env_class: type[RegraspEnv]
    scenario: Scenario
    steps: int
    supports: frozenset[str]
    cameras: tuple[str, ...]
    bare: Any
    held_box: tuple[tuple[float, float, float], float]
    closing_steps: int
    out_of_reach: tuple[float, float, float]
    direct_seed: int
    regrasp_seed: int

    @property
    def env_id(self) -> str:
        """Gymnasium id."""
        return f"regrasp_gym/{self.name}-v0"

    @property
    def joints(self) -> int:
        """Number of the arm's joints."""
        return len(self.scenario.robot.arm_joints)

    @property
    def layouts(self) -> dict[str, tuple[tuple[str, int], ...]]:
        """Layout of each vector of the observations."""
        return {
            "observation": observation.state_layout(self.joints, self.scenario.max_others),
            "agent_pos": observation.agent_layout(self.joints),
            "environment_state": observation.environment_layout(self.scenario.max_others),
        }

    def make(self, **arguments: Any) -> gym.Env:
        """A new environment."""
        return gym.make(self.env_id, **arguments)

    def scene(self, seed: int) -> Scene:
        """The scene of a seed."""
        return self.scenario.make_scene(seed, None)

    def with_box(self, seed: int) -> Scene:
        """The scene of a seed with `held_box` as its target."""
        edges, mass = self.held_box
        corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * edges
        scene = self.scene(seed)
        target = solid(scene.target.name, "box", mass, [corners], shape="box", friction=scene.target.model.friction)
        return dataclasses.replace(scene, target=PlacedObject(target, scene.target.pose))


PANDA = Facts(
    name="PandaYCB",
    env_class=PandaYCBEnv,
    scenario=PANDA_YCB,
    steps=1000,
    supports=frozenset({"table", "shelf_board"}),
    cameras=("front", "wrist", "overview"),
    bare=TableShelfConfig(table_clutter=(0, 0), shelf_clutter=(0, 0)),
    held_box=((0.06, 0.06, 0.06), 0.1),
    closing_steps=6,
    out_of_reach=(3.0, 3.0, 0.5),
    direct_seed=3,
    regrasp_seed=2,
)

EXCAVATOR = Facts(
    name="ExcavatorStones",
    env_class=ExcavatorStonesEnv,
    scenario=EXCAVATOR_STONES,
    steps=2000,
    supports=frozenset({"ground", "pick_slope", "place_slope"}),
    cameras=("site", "cab", "overview"),
    bare=SlopesConfig(pick_stones=(0, 0), place_stones=(0, 0), on_top=0.0),
    held_box=((0.8, 0.9, 0.6), 800.0),
    closing_steps=20,
    out_of_reach=(-15.0, 0.0, 1.0),
    direct_seed=3,
    regrasp_seed=53,
)

SCENARIOS = (PANDA, EXCAVATOR)


def still(env: gym.Env) -> np.ndarray:
    """The action that keeps the commanded position with open fingers."""
    inner = env.unwrapped
    return inner.command.astype(np.float32) if inner.control_mode == "joint_pos" else np.eye(7, dtype=np.float32)[6]


def nudged(env: gym.Env, by: float) -> np.ndarray:
    """The last command with every joint moved for this many seconds at full speed, to alternating sides."""
    command, speed = env.unwrapped.command, env.unwrapped.scenario.robot.max_velocity
    command[:-1] += by * speed * np.resize([1.0, -1.0], len(speed))
    return command


def assert_equal(a: Any, b: Any) -> None:
    """Equal to the last bit, including in dictionaries."""
    if isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            assert_equal(a[key], b[key])
    else:
        np.testing.assert_array_equal(a, b)
