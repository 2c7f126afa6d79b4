"""One trial of releases: an object released tilted in several ways, each settling in MuJoCo."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from regrasp_bench.tables.drops import DropTable, RetreatingGripper, angle_between
from regrasp_bench.tables.hulls import random_hull, stone
from regrasp_gym.errors import BenchError
from regrasp_gym.objects import OBJECTS
from regrasp_gym.objects.model import ObjectModel
from regrasp_gym.reports.report import Record

if TYPE_CHECKING:
    from regrasp_planner import Grasp, Gripper
    from regrasp_planner.placement.basins import ReleaseCone
    from regrasp_planner.placement.stab_pose import StablePoses

POSES = 8
"""Stable poses considered of each object, most stable first: as many as the planner tries."""

BEYOND = (1.5, 2.0)
"""Tilts of the control group, as multiples of the cone's half-angle."""

LEAST_TILT = np.deg2rad(1)
"""A release with less tilt counts as static, radians."""

RETREAT = 0.1
"""Length of the gripper's retreat, metres."""

_TRIES = 60
_BATCHES = 4


def prepare(setting: Record) -> Callable[[int], Record]:
    """The function that runs a trial, with the Panda's gripper."""
    from regrasp_gym.robots.panda import PANDA

    return partial(_release, PANDA.planner_robot().gripper)


def _release(gripper: Gripper, trial: int) -> Record:
    """One release that is planned or within the cone, one outside of it and one in the paper's cone."""
    from regrasp_planner.placement.basins import alpha_shape_angles
    from regrasp_planner.placement.tilted_release import BLOCKED, settling_clearance

    rng = np.random.default_rng([trial, 0x5E77])
    planned, is_stone = trial % 2 == 0, trial // 2 % 2 == 1
    without: list[str] = []
    for attempt in range(_TRIES):
        thing = stone(_TRIES * trial + attempt) if is_stone else OBJECTS[str(rng.choice(sorted(OBJECTS)))]
        poses, cones = _cones(thing)
        usable = [k for k in range(min(POSES, len(poses))) if cones[k].half_angle > LEAST_TILT]
        if not usable:
            without.append(thing.name)
            continue
        k = int(rng.choice(usable))
        cone = cones[k]
        if not planned:
            x, retreating = random_in_cone(cone.axis, cone.half_angle, rng), None
            break
        if found := _planned(thing, gripper, cones, k, rng):
            x, retreating = found
            break
    else:
        raise BenchError(f"none of {_TRIES} objects has a non-static release (trial {trial})")
    table = _table(thing)
    tilt = angle_between(x, cone.axis)
    far = min(float(rng.uniform(*BEYOND)) * cone.half_angle, np.pi)
    side = (x - (x @ cone.axis) * cone.axis) / np.sin(tilt)
    outside = np.cos(far) * cone.axis + np.sin(far) * side
    drops = {
        "planned" if planned else "anywhere in the cone": _drop(table, x, cone.axis, cone.half_angle, rng),
        "outside of the cone": _drop(table, outside, cone.axis, cone.half_angle, rng),
    }
    if retreating is not None:
        with_gripper = DropTable(thing, retreating)
        drops["planned, gripper retreating"] = _drop(with_gripper, x, cone.axis, cone.half_angle, rng)
        pieces = list(zip(retreating.bodies, retreating.travel, strict=True))
        fingers = [(body + travel)[None] for body, travel in pieces[1:]]
        if settling_clearance(thing.pieces, fingers, cone.axis, x[None])[0] >= BLOCKED * float(gripper.max_opening):
            drops["… no finger in the way"] = drops["planned, gripper retreating"]
    sampled = alpha_shape_angles(poses)
    if theirs := [j for j in range(min(POSES, len(poses))) if sampled[j] > LEAST_TILT]:
        j = int(rng.choice(theirs))
        axis, half = poses.directions[j], float(sampled[j])
        drops["paper's cone"] = _drop(table, random_in_cone(axis, half, rng), axis, half, rng)
    return {
        "thing": thing.name,
        "pose": k,
        "half_angles": [cone.half_angle, float(sampled[k])],
        "without_cone": without,
        "drops": {name: {**drop, "stone": is_stone} for name, drop in drops.items()},
    }


def _planned(
    thing: ObjectModel, gripper: Gripper, cones: Sequence[ReleaseCone], k: int, rng: np.random.Generator
) -> tuple[Float[np.ndarray, " 3"], RetreatingGripper] | None:
    """A tilted release into pose k, and its gripper, as GraspGen⁺ plans it for a target in another pose before."""
    from regrasp_planner.grasp.grasp_gen import GraspSearch

    before = cones[int(rng.choice(np.delete(np.arange(min(POSES, len(cones))), k)))] if len(cones) > 1 else None
    search = GraspSearch(thing.body(), (), gripper)
    tilted = [
        (found.release, found.grasp)
        for batch in islice(search.grasps(before, cones[k]), _BATCHES)
        for found in batch
        if found.release is not None and angle_between(found.release, cones[k].axis) > LEAST_TILT
    ]
    if not tilted:
        return None
    x, grasp = tilted[int(rng.integers(len(tilted)))]
    return x, _retreating(gripper, grasp)


def _retreating(gripper: Gripper, grasp: Grasp) -> RetreatingGripper:
    """The gripper at a grasp. It opens fully and retreats along its approach axis."""
    from regrasp_planner.robot.gripper import enclosing_points, reduce_gripper

    turn = Rotation.from_quat(grasp.pose[:4], scalar_first=True)
    screws = np.concatenate([np.zeros((1, 6)), np.asarray(gripper.screws)])
    if screws[:, 3:].any():
        raise BenchError("the fingers turn about hinges: this benchmark needs a gripper with sliding fingers")
    hand = reduce_gripper(gripper).hand
    bodies = [enclosing_points(hand[k]) + grasp.theta * screws[k, :3] for k in range(len(screws))]
    opening = float(gripper.upper) - grasp.theta
    return RetreatingGripper(
        bodies=tuple(turn.apply(body) + grasp.pose[4:] for body in bodies),
        travel=tuple(turn.apply(opening * screw[:3]) for screw in screws),
        back=turn.apply(-RETREAT * np.asarray(gripper.approach_axis)),
    )


def _drop(
    table: DropTable,
    x: Float[np.ndarray, " 3"],
    axis: Float[np.ndarray, " 3"],
    half_angle: float,
    rng: np.random.Generator,
) -> Record:
    from regrasp_planner.placement.basins import DROP
    from regrasp_planner.placement.stab_pose import rotation_to

    turn = rng.uniform(0, 2 * np.pi)
    yaw = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    landing = table.drop(yaw @ rotation_to(x), DROP)
    return {
        "tilt": angle_between(x, axis),
        "half_angle": half_angle,
        "settled": landing.settled_into(axis),
        "away_degrees": float(np.rad2deg(landing.angle_to(axis))),
        "rested": landing.rested,
        "seconds": landing.seconds,
    }


def random_in_cone(
    axis: Float[np.ndarray, " 3"], half_angle: float, rng: np.random.Generator
) -> Float[np.ndarray, " 3"]:
    """A random direction in a cone, (3,), uniform over its solid angle."""
    cosine = rng.uniform(np.cos(half_angle), 1.0)
    side = np.cross(axis, random_hull(rng, 1)[0])
    return cosine * axis + np.sqrt(1 - cosine**2) * side / np.linalg.norm(side)


@lru_cache(maxsize=32)
def _cones(thing: ObjectModel) -> tuple[StablePoses, tuple[ReleaseCone, ...]]:
    from regrasp_planner import stable_poses
    from regrasp_planner.placement.basins import release_cones

    body = thing.body()
    poses = stable_poses(body.hull_vertices(), body.center_of_mass)
    return poses, release_cones(poses)


@lru_cache(maxsize=32)
def _table(thing: ObjectModel) -> DropTable:
    return DropTable(thing)
