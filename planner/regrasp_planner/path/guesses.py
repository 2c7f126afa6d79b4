"""Initial guesses for the trajectory optimiser: polylines that might lead around what is in the way."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from regrasp_planner.ik.line import follow_line
from regrasp_planner.path.clearance import PathClearance
from regrasp_planner.path.polyline import chord_lengths, inner_points
from regrasp_planner.path.space import ConfigurationSpace

_RETREAT = 0.15
"""Length of a retreat of the gripper, metres."""
_SHORTEST_RETREAT = 0.2
"""Share of a retreat that the arm has to be able to follow for it to count."""
_SAMPLES = 20
"""Configurations at which a guess is ranked."""
_LENGTH_WEIGHT = 0.01
"""Metres of shortfall at every sample that weigh as much as a radian of detour."""


def retreats(
    space: ConfigurationSpace, q: Float[np.ndarray, " n"], coarse: bool = False
) -> list[Float[np.ndarray, "K n"]]:
    """Two retreats of the gripper from q: straight up, and back along its approach axis.

    Each is a list of configurations (K, n) that begins with q, 5 mm apart (five times that if ``coarse``); q alone
    where the arm cannot follow the line.
    """
    pose, _ = space.kinematics.gripper(q)
    approach = pose[:3, :3] @ np.asarray(space.model.arrays.robot.gripper.approach_axis, float)
    lines = [
        follow_line(space.kinematics, q, _RETREAT * direction, coarse=coarse)
        for direction in (np.array([0.0, 0.0, 1.0]), -approach)
    ]
    return [line.configurations if line.fraction >= _SHORTEST_RETREAT else q[None] for line in lines]


def initial_guesses(
    space: ConfigurationSpace, start: Float[np.ndarray, " n"], goal: Float[np.ndarray, " n"], rng: np.random.Generator
) -> list[Float[np.ndarray, "K n"]]:
    """Polylines (K, n) from start to goal: over retreats at either end, over home, and over random configurations."""
    ways = [_ends(line) for line in (start[None], *retreats(space, start, coarse=True))]
    returns = [_ends(line)[::-1] for line in (goal[None], *retreats(space, goal, coarse=True))]
    guesses = [np.concatenate([a, b]) for a in ways for b in returns if len(a) + len(b) > 2]
    home, middle = np.asarray(space.model.arrays.robot.home, float), 0.5 * (start + goal)
    vias = [home, 0.5 * (home + middle), *rng.uniform(space.lower, space.upper, (2, len(start)))]
    vias += [space.clipped(middle + rng.normal(scale=0.5, size=len(start)))]
    guesses += [np.stack([start, via, goal]) for via in vias]
    return [*guesses, np.concatenate([ways[-1], home[None], returns[-1]])]


def _ends(line: Float[np.ndarray, "K n"]) -> Float[np.ndarray, "E n"]:
    """First and last configuration of a line; one if it has no other."""
    return line[[0, -1]] if len(line) > 1 else line


def rank_guesses(clearance: PathClearance, guesses: list[Float[np.ndarray, "K n"]]) -> list[Float[np.ndarray, "K n"]]:
    """The guesses, least obstructed first: by total shortfall of clearance along the way, and by length."""
    q = np.concatenate([inner_points(guess, _SAMPLES) for guess in guesses])
    required = clearance.required(q)
    found = clearance.measure(q, required)
    shortfall = np.maximum(required[found.sample, found.pair] - found.distance, 0.0)
    total = np.bincount(found.sample // _SAMPLES, shortfall, minlength=len(guesses))
    lengths = np.array([chord_lengths(guess)[-1] for guess in guesses])
    order = np.argsort(total + _LENGTH_WEIGHT * lengths, kind="stable")
    return [guesses[i] for i in order]
