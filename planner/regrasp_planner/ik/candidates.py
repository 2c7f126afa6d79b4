"""Candidates for a gripper pose: configurations from many starts, ranked, and checked for collisions."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from regrasp_planner.collision.clearance import configuration_clearance
from regrasp_planner.collision.model import CollisionModel
from regrasp_planner.ik.descent import Descent, descend_to_pose
from regrasp_planner.robot.model import Arm

SLOTS, STARTS = 8, 32
"""Lanes of every batch: 8 slots of 32 starts. The targets of the batch share the slots evenly."""
ENOUGH = 10
"""Solutions of every target after which a descent stops."""
SAME_CONFIGURATION = 0.1
"""Configurations closer than this in every joint (radians) count as one."""
GOOD_CLEARANCE = 0.03
"""Metres; more clearance makes no solution better."""


@dataclass(frozen=True)
class IkSolution:
    """A collision-free configuration with the gripper at its target.

    Attributes:
        q: (n,) radians.
        position_error: metres.
        rotation_error: radians.
        clearance: smallest distance minus margin, metres, cut at `GOOD_CLEARANCE`.
    """

    q: Float[np.ndarray, " n"]
    position_error: float
    rotation_error: float
    clearance: float


class Collision(NamedTuple):
    """A configuration that collides: its clearance (metres, negative), the pair that attains it, and joint angles."""

    clearance: float
    pair: int
    q: Float[np.ndarray, " n"]


@dataclass
class TargetSearch:
    """One target and what is known about it.

    Attributes:
        model: the bodies that may collide.
        target: (7,) pose of the gripper frame in the world.
        theta: finger coordinate.
        reference: (n,) configuration to stay near, radians.
        closest: (n,) configuration with the smallest pose error so far.
        closest_error: that error, metres.
        gripper_collision: the worst collision of the gripper itself at the target, which no motion of the arm avoids.
        solutions: collision-free configurations.
        colliding: configurations at the target that collide.
    """

    model: CollisionModel
    target: Float[np.ndarray, " 7"]
    theta: float
    reference: Float[np.ndarray, " n"]
    closest: Float[np.ndarray, " n"]
    closest_error: float = np.inf
    gripper_collision: Collision | None = None
    solutions: list[IkSolution] = field(default_factory=list[IkSolution])
    colliding: list[Collision] = field(default_factory=list[Collision])


def batches(searches: list[TargetSearch]) -> list[list[TargetSearch]]:
    """At most `SLOTS` searches at a time."""
    return [searches[i : i + SLOTS] for i in range(0, len(searches), SLOTS)]


def by_model(searches: Iterable[TargetSearch]) -> list[list[TargetSearch]]:
    """Searches that share a collision model, together."""
    groups: dict[int, list[TargetSearch]] = {}
    for search in searches:
        groups.setdefault(id(search.model), []).append(search)
    return list(groups.values())


def draw_starts(
    arm: Arm, batch: list[TargetSearch], fixed: Float[np.ndarray, "S n"], rng: np.random.Generator
) -> Float[np.ndarray, "slots starts n"]:
    """Starts of each slot: the search's reference, the fixed ones, then random ones within the limits."""
    low, high = np.asarray(arm.lower, float), np.asarray(arm.upper, float)
    starts = rng.uniform(low, high, (SLOTS, STARTS, arm.dof))
    for slot, search in enumerate(batch):
        known = np.concatenate([search.reference[None], fixed])[: STARTS // 2]
        starts[slot, : len(known)] = known
    return starts


def descend(
    arm: Arm, batch: list[TargetSearch], starts: Float[np.ndarray, "slots starts n"], iterations: int
) -> list[Descent]:
    """`descend_to_pose` for each search of a batch, over all lanes of its slots; the searches take turns at slots."""
    owner = np.arange(SLOTS) % len(batch)
    ends = descend_to_pose(arm, np.stack([batch[i].target for i in owner]), starts, ENOUGH, iterations)
    return [Descent(*(leaf[owner == i].reshape(-1, *leaf.shape[2:]) for leaf in ends)) for i in range(len(batch))]


def ranking_cost(search: TargetSearch, q: Float[np.ndarray, "N n"]) -> Float[np.ndarray, " N"]:
    """Distance from the reference in units of the joints' ranges, and nearness to the limits; clearance not counted."""
    arm = search.model.arrays.robot.arm
    low, high = np.asarray(arm.lower), np.asarray(arm.upper)
    # About 0 over most of a joint's range, and 1 at a limit.
    at_limits = (((2 * q - low - high) / (high - low)) ** 8).sum(1)
    return np.linalg.norm((q - search.reference) / (high - low), axis=1) + 0.2 * at_limits


def distinct(q: Float[np.ndarray, "N n"]) -> list[int]:
    """Indices of configurations that differ from all those kept before them."""
    kept: list[int] = []
    for i in range(len(q)):
        if not kept or np.abs(q[kept] - q[i]).max(1).min() > SAME_CONFIGURATION:
            kept.append(i)
    return kept


def _candidates(search: TargetSearch, ends: Descent) -> list[IkSolution]:
    """Distinct configurations at the target, best first; their clearance is not known yet."""
    order = np.flatnonzero(ends.solved())
    order = order[np.argsort(ranking_cost(search, ends.q[order]), kind="stable")]
    order = order[distinct(ends.q[order])]
    return [IkSolution(ends.q[i], float(ends.position_error[i]), float(ends.rotation_error[i]), np.nan) for i in order]


def screen(batch: list[TargetSearch], descents: list[Descent], max_solutions: int) -> None:
    """Sort candidates into solutions and collisions, best first, until each search has enough solutions."""
    candidates: dict[int, list[IkSolution]] = {}
    for search, ends in zip(batch, descents, strict=True):
        error = ends.pose_error()
        best = int(error.argmin())
        if error[best] < search.closest_error:
            search.closest_error, search.closest = float(error[best]), ends.q[best]
        candidates[id(search)] = _candidates(search, ends)
    # At least 64 configurations fill a batch of clearances.
    size = max(max_solutions, -(-64 // len(batch)))
    for part in by_model(batch):
        for begin in range(0, SLOTS * STARTS, size):
            pairs = [
                (search, candidate)
                for search in part
                if len(search.solutions) < max_solutions
                for candidate in candidates[id(search)][begin : begin + size]
            ]
            if not pairs:
                break
            q = np.stack([candidate.q for _, candidate in pairs])
            openings = np.array([search.theta for search, _ in pairs])
            clearance = configuration_clearance(part[0].model, q, openings, cap=GOOD_CLEARANCE)
            for (search, candidate), value, pair in zip(pairs, clearance.value, clearance.pair, strict=True):
                if value >= 0:
                    search.solutions.append(replace(candidate, clearance=float(value)))
                else:
                    search.colliding.append(Collision(float(value), int(pair), candidate.q))
