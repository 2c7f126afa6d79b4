"""The features of a dataset, and how a step of an environment becomes a frame.

A frame holds the observation *before* a step, the action and the outcome: ``observation.*``, ``action``,
``stage_index`` and ``seed`` belong to time t, ``next.*`` to time t + 1. The observation after the last step is not
stored; replaying the episode gives it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

from regrasp_gym.errors import RegraspGymError

if TYPE_CHECKING:
    from regrasp_gym.envs.base import RegraspEnv

STATE = "observation.state"
ENVIRONMENT_STATE = "observation.environment_state"
IMAGE_PREFIX = "observation.images."
ACTION = "action"
REWARD = "next.reward"
SUCCESS = "next.success"
DONE = "next.done"
TRUNCATED = "next.truncated"
STAGE_INDEX = "stage_index"
SEED = "seed"

IMAGES_OBS_TYPE = "pixels_agent_pos"
"""``obs_type`` with camera images."""
VECTORS_OBS_TYPE = "state"
"""``obs_type`` without rendering; `observe` gives the same vectors as with images."""

POSE_NAMES = ("qw", "qx", "qy", "qz", "x", "y", "z")
SIZE_NAMES = ("half_x", "half_y", "half_z")
ENTRY_NAMES = {7: POSE_NAMES, 3: SIZE_NAMES, 11: ("present", *POSE_NAMES, *SIZE_NAMES)}
"""Names of the entries of the parts of ``environment_state``, by the number of entries."""

MEANING = {
    STATE: "joint positions (rad) and finger coordinate, before the step",
    ENVIRONMENT_STATE: "poses (wxyz, m) and half sizes (m) of target, goal and other objects, before the step",
    ACTION: "action given to the environment, unchanged",
    REWARD: "reward of the step",
    SUCCESS: "whether the task counts as solved after the step",
    DONE: "true on the episode's last frame only",
    TRUNCATED: "true if the time limit ended the episode at this step",
    STAGE_INDEX: "stage of the plan that the action belongs to, from 0; each stage has one grasp",
    SEED: "seed given to `reset`; it recreates the scene",
}
"""One line per feature, for the dataset card."""


class FeatureError(RegraspGymError, ValueError):
    """An environment's observations or actions do not fit a dataset."""


@dataclass(frozen=True)
class Observation:
    """The observation that a frame stores.

    Attributes:
        state: (n,) float32, joints of the robot.
        environment_state: (m,) float32, poses and sizes of everything else.
        images: (H, W, 3) uint8 by camera.
    """

    state: np.ndarray
    environment_state: np.ndarray
    images: dict[str, np.ndarray]


@dataclass(frozen=True)
class Step:
    """One step of an environment.

    Attributes:
        observation: the state before the step.
        action: (a,) float32, as given to the environment.
        stage_index: stage of the plan that the action belongs to.
        reward: reward of the step.
        success: ``info["is_success"]`` after the step.
        truncated: whether the time limit ended the episode at this step.
    """

    observation: Observation
    action: np.ndarray
    stage_index: int
    reward: float
    success: bool
    truncated: bool


def base_env(env: gym.Env) -> RegraspEnv:
    """The environment below the wrappers.

    Raises:
        FeatureError: it is not an environment of this project.
    """
    from regrasp_gym.envs.base import RegraspEnv

    if not isinstance(env.unwrapped, RegraspEnv):
        raise FeatureError(f"{type(env.unwrapped).__name__} is not an environment of regrasp_gym.")
    return env.unwrapped


def features_of(env: gym.Env) -> dict[str, dict[str, Any]]:
    """LeRobot's table of features for the episodes of ``env``.

    Args:
        env: an environment of this project; its images are included if its ``obs_type`` is `IMAGES_OBS_TYPE`.

    Returns:
        dtype, shape and names of the entries, by key.

    Raises:
        FeatureError: the environment is of another project, or its actions do not fit.
    """
    base = base_env(env)
    if not isinstance(env.action_space, gym.spaces.Box) or env.action_space.dtype != np.float32:
        raise FeatureError(f"The action space must be a Box of float32, not {env.action_space}.")
    features: dict[str, dict[str, Any]] = {
        STATE: _vector(_state_names(base)),
        ENVIRONMENT_STATE: _vector(_environment_state_names(base)),
    }
    for camera in base.scenario.pixels if base.obs_type == IMAGES_OBS_TYPE else ():
        features[IMAGE_PREFIX + camera] = {
            "dtype": "video",
            "shape": (*base.image_size, 3),
            "names": ["height", "width", "channels"],
        }
    features[ACTION] = _vector(_action_names(base))
    if features[ACTION]["shape"] != env.action_space.shape:
        raise FeatureError(f"Actions have shape {env.action_space.shape}, and their names {features[ACTION]['shape']}.")
    for key in (SUCCESS, DONE, TRUNCATED):
        features[key] = _scalar("bool")
    features[REWARD] = _scalar("float32")
    features[STAGE_INDEX] = _scalar("int64")
    features[SEED] = _scalar("int64")
    return features


def observe(env: gym.Env, obs: dict[str, Any]) -> Observation:
    """The observation of the current state that a frame stores.

    Args:
        env: the environment.
        obs: what its ``reset`` or ``step`` returned last; only the images are used.
    """
    from regrasp_gym.envs.observation import agent_vector, environment_vector

    base = base_env(env)
    return Observation(
        state=agent_vector(base.world).astype(np.float32),
        environment_state=environment_vector(base.world, base.scenario.max_others).astype(np.float32),
        images={camera: np.array(image) for camera, image in obs.get("pixels", {}).items()},
    )


def frame_of(step: Step, *, seed: int, done: bool, task: str) -> dict[str, Any]:
    """One frame for ``LeRobotDataset.add_frame``.

    Args:
        step: the step of the environment.
        seed: seed of the episode.
        done: whether it is the last step of the episode.
        task: the task in words.

    Returns:
        A value for every key of `features_of` and for ``task``.
    """
    frame: dict[str, Any] = {
        STATE: step.observation.state,
        ENVIRONMENT_STATE: step.observation.environment_state,
        ACTION: step.action,
        REWARD: np.array([step.reward], dtype=np.float32),
        SUCCESS: np.array([step.success]),
        DONE: np.array([done]),
        TRUNCATED: np.array([step.truncated]),
        STAGE_INDEX: np.array([step.stage_index], dtype=np.int64),
        SEED: np.array([seed], dtype=np.int64),
        "task": task,
    }
    for camera, image in step.observation.images.items():
        frame[IMAGE_PREFIX + camera] = image
    return frame


def _state_names(env: RegraspEnv) -> list[str]:
    return [*env.scenario.robot.arm_joints, "theta"]


def _environment_state_names(env: RegraspEnv) -> list[str]:
    from regrasp_gym.envs.observation import OTHER_SIZE, environment_layout

    names: list[str] = []
    for part, count in environment_layout(env.scenario.max_others):
        per_item = OTHER_SIZE if part == "other objects" else count
        for index in range(count // per_item):
            item = f"{part} {index}" if count > per_item else part
            names += [f"{item}.{entry}" for entry in ENTRY_NAMES[per_item]]
    return names


def _action_names(env: RegraspEnv) -> list[str]:
    if env.control_mode == "ee_delta":
        return ["dx", "dy", "dz", "rx", "ry", "rz", "theta"]
    return _state_names(env)


def _vector(names: list[str]) -> dict[str, Any]:
    return {"dtype": "float32", "shape": (len(names),), "names": names}


def _scalar(dtype: str) -> dict[str, Any]:
    return {"dtype": dtype, "shape": (1,), "names": None}
