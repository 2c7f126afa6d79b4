"""Observations: vectors of fixed size, whatever the number of objects.

Vectors are float64 in metres, radians and seconds; poses are `canonical` wxyz_xyz. Each layout is defined here, as a
table of (name, size). The environments' docstrings repeat it for their robot, and a test compares the two.
"""

from __future__ import annotations

import numpy as np
from gymnasium import spaces
from jaxtyping import Float

from regrasp_gym.envs.reward import GOAL_SIZE
from regrasp_gym.geometry.poses import canonical
from regrasp_gym.simulation.scenario import Tolerance
from regrasp_gym.simulation.world import World

OTHER_SIZE = 11
"""Entries per object besides the target: present (0 or 1), pose (7), half extents (3). All 0 if absent."""


def state_layout(joints: int, max_others: int) -> tuple[tuple[str, int], ...]:
    """Parts of the vector ``observation``."""
    return (
        ("joint positions", joints),
        ("joint velocities", joints),
        ("finger coordinate", 1),
        ("finger rate", 1),
        ("gripper pose", 7),
        ("target velocity", 6),
        ("target half extents", 3),
        ("other objects", OTHER_SIZE * max_others),
    )


def environment_layout(max_others: int) -> tuple[tuple[str, int], ...]:
    """Parts of the vector ``environment_state``."""
    return (
        ("target pose", 7),
        ("target half extents", 3),
        ("goal pose", 7),
        ("other objects", OTHER_SIZE * max_others),
    )


def agent_layout(joints: int) -> tuple[tuple[str, int], ...]:
    """Parts of the vector ``agent_pos``: those of an action under ``joint_pos``."""
    return (("joint positions", joints), ("finger coordinate", 1))


def size(layout: tuple[tuple[str, int], ...]) -> int:
    """Entries of a layout."""
    return sum(count for _, count in layout)


def state_space(joints: int, max_others: int) -> spaces.Dict:
    """Space of observations of type ``state``, the dictionary of a goal environment."""
    return spaces.Dict(
        {
            "observation": _vectors(size(state_layout(joints, max_others))),
            "achieved_goal": _vectors(GOAL_SIZE),
            "desired_goal": _vectors(GOAL_SIZE),
        }
    )


def pixels_space(joints: int, max_others: int, cameras: tuple[str, ...], height: int, width: int) -> spaces.Dict:
    """Space of observations of type ``pixels_agent_pos``."""
    picture = spaces.Box(0, 255, (height, width, 3), np.uint8)
    return spaces.Dict(
        {
            "pixels": spaces.Dict(dict.fromkeys(cameras, picture)),
            "agent_pos": _vectors(size(agent_layout(joints))),
            "environment_state": _vectors(size(environment_layout(max_others))),
        }
    )


def state_vector(world: World, max_others: int) -> Float[np.ndarray, " s"]:
    """The vector ``observation``, laid out by `state_layout`."""
    return np.concatenate(
        [
            world.joint_positions,
            world.joint_velocities,
            [world.theta, world.theta_rate],
            world.gripper_pose,
            world.target_velocity,
            world.object_sizes[0] / 2,
            _others(world, max_others),
        ]
    )


def environment_vector(world: World, max_others: int) -> Float[np.ndarray, " e"]:
    """The vector ``environment_state``, laid out by `environment_layout`."""
    return np.concatenate(
        [
            world.target_pose,
            world.object_sizes[0] / 2,
            canonical(world.scene.goal_pose),
            _others(world, max_others),
        ]
    )


def agent_vector(world: World) -> Float[np.ndarray, " n+1"]:
    """The vector ``agent_pos``, laid out by `agent_layout`."""
    return np.append(world.joint_positions, world.theta)


def achieved_goal(world: World, tolerance: Tolerance, held: bool = False) -> Float[np.ndarray, " 10"]:
    """The goal that the current state achieves (see `regrasp_gym.envs.reward`).

    The target counts as moving while it is faster than the tolerance, or while nothing other than the gripper supports
    it: an object at the top of a throw is not at rest. If it has to be ``held``, it counts as moving unless the gripper
    alone supports it.
    """
    pose, velocity = world.target_pose, world.target_velocity
    touched, supported = world.target_contacts()
    slow = np.linalg.norm(velocity[:3]) <= tolerance.speed and np.linalg.norm(velocity[3:]) <= tolerance.turn_rate
    distance = np.linalg.norm(world.gripper_pose[4:] - pose[4:])
    carried = touched and not supported if held else supported
    return np.concatenate([pose, np.array([not (slow and carried), touched, distance], float)])


def desired_goal(world: World, held: bool = False) -> Float[np.ndarray, " 10"]:
    """The scene's goal: the target in place, at rest, and untouched unless it has to be ``held``."""
    return np.concatenate([canonical(world.scene.goal_pose), np.array([0.0, held, 0.0])])


def _others(world: World, max_others: int) -> Float[np.ndarray, " o"]:
    rows = np.zeros((max_others, OTHER_SIZE))
    count = len(world.scene.others)
    if count:
        rows[:count, 0] = 1
        rows[:count, 1:8] = world.other_poses
        rows[:count, 8:] = world.object_sizes[1:] / 2
    return rows.ravel()


def _vectors(count: int) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, (count,), np.float64)
