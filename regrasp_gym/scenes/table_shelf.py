"""Scenes of the Panda: a cluttered table, a shelf with a free place, and a free patch of table in between.

A scene depends on a seed and a `TableShelfConfig` alone. The robot's base is the world's origin, the table top is
z = 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from regrasp_gym.checks import check_seed
from regrasp_gym.errors import SceneError
from regrasp_gym.geometry.polygons import footprint_gap
from regrasp_gym.geometry.poses import Pose, about_z, shepperd_quaternion, to_pose, turn
from regrasp_gym.objects.model import ObjectModel
from regrasp_gym.objects.ycb import OBJECTS
from regrasp_gym.scenes.graspable import graspable_by_part
from regrasp_gym.scenes.resting import RestingPose, resting_poses, upright_pose
from regrasp_gym.scenes.scene import Fixture, PlacedObject, ReleasePatch, Scene, level_support
from regrasp_gym.scenes.table_shelf_config import TableShelfConfig

_TRIES = 32
"""Random placements of one object, tried before another object replaces it."""

_SPARE = 5
"""Extra objects tried before the scene gets fewer."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TableShelfScene(Scene):
    """A scene of the Panda.

    Attributes:
        table_objects: the other objects on the table.
        shelf_objects: the objects on the shelf, upright.
    """

    config: TableShelfConfig
    table_objects: tuple[PlacedObject, ...]
    shelf_objects: tuple[PlacedObject, ...]

    @property
    def others(self) -> tuple[PlacedObject, ...]:
        """All objects except the target."""
        return self.table_objects + self.shelf_objects

    @property
    def instruction(self) -> str:
        """The task in words."""
        return f"put the {self.target.model.label} upright on the shelf"


def make_scene(seed: int, config: TableShelfConfig | None = None) -> TableShelfScene:
    """The scene of a seed.

    The target and the clutter lie on the table in random resting poses at random yaw. Resting poses are drawn by
    landing probability, the target's among those that the gripper fits over. Seen from above objects do not overlap, so
    their hulls do not either. On the shelf, upright objects at random yaw stand around the goal. An object without a
    free place after a bounded number of tries is replaced or, if that fails too, left out, so every seed gives a scene.

    Args:
        seed: a non-negative integer.
        config: the default if None.

    Raises:
        SceneError: negative seed, or a pick area or board too small for the target alone.
    """
    config = config or TableShelfConfig()
    check_seed(seed, "scene")
    rng = np.random.default_rng([seed, 0x7AB1E])
    # A separate stream: objects on the table do not change those on the shelf.
    (shelf_rng,) = rng.spawn(1)
    model = OBJECTS[str(rng.choice(config.targets))]
    names = [str(name) for name in rng.permutation(config.clutter) if name != model.name]
    pick = _Area(np.array(config.pick_center), 0.0, np.array(config.pick_size), 0.0, config.pick_gap)
    start = _place_target(rng, model, pick, config)
    n_table = int(rng.integers(config.table_clutter[0], config.table_clutter[1] + 1))
    table = _scatter(rng, n_table, names, pick, lambda m: _draw_resting(rng, resting_poses(m), config.landing_weight))

    board = _shelf_area(config)
    goal = _place_goal(shelf_rng, model, board, config)
    n_shelf = int(shelf_rng.integers(config.shelf_clutter[0], config.shelf_clutter[1] + 1))
    taken = {model.name, *(thing.name for thing in table)}
    standing = [str(name) for name in shelf_rng.permutation(config.shelf_objects) if name not in taken]
    shelf = _scatter(shelf_rng, n_shelf, standing, board, upright_pose)
    center = np.array([*config.release_center, 0.0])
    return TableShelfScene(
        seed=int(seed),
        config=config,
        target=start,
        goal_pose=goal,
        table_objects=table,
        shelf_objects=shelf,
        fixtures=_fixtures(config),
        release=ReleasePatch(center, np.array(config.release_size) / 2),
    )


class _Area:
    """A rectangle for objects, and the objects already on it."""

    def __init__(self, center: np.ndarray, yaw: float, size: np.ndarray, height: float, gap: float) -> None:
        self.center, self.yaw, self.size, self.height, self.gap = center, yaw, size, height, gap
        self.placed: list[np.ndarray] = []

    def draw(self, rng: np.random.Generator, resting: RestingPose) -> _Draws:
        """Random yaws and positions at which the footprint is inside the rectangle."""
        return self.turned(rng, resting, rng.uniform(-np.pi, np.pi, _TRIES))

    def turned(
        self, rng: np.random.Generator, resting: RestingPose, yaws: Float[np.ndarray, " T"], side_gap: float = 0.0
    ) -> _Draws:
        """Given yaws and random positions, with a gap on both sides in local y."""
        footprints = np.einsum("tij,kj->tki", turn(yaws), resting.footprint)
        inside = self.size / 2 - [0.0, side_gap]
        low, high = -inside - footprints.min(axis=1), inside - footprints.max(axis=1)
        positions = low + rng.random((_TRIES, 2)) * (high - low)
        return _Draws(yaws, positions, footprints, low, (low <= high).all(axis=1))

    def put(self, resting: RestingPose, draws: _Draws) -> Pose | None:
        """Occupy the first draw that is inside and free; its pose in the world, or None."""
        polygons = draws.footprints + draws.positions[:, None]
        free = draws.inside.copy()
        for other in self.placed:
            free &= footprint_gap(polygons, other) >= self.gap
        if not free.any():
            return None
        k = int(free.argmax())
        self.placed.append(polygons[k])
        world = self.center + turn(self.yaw) @ draws.positions[k]
        return to_pose(
            shepperd_quaternion(about_z(self.yaw + draws.yaws[k]) @ resting.rotation),
            [*world, self.height + resting.height],
        )


@dataclass(eq=False)
class _Draws:
    """T random placements: yaws (T,), positions (T, 2), rotated footprints (T, K, 2), least positions (T, 2)."""

    yaws: np.ndarray
    positions: np.ndarray
    footprints: np.ndarray
    low: np.ndarray
    inside: np.ndarray


def _place_target(rng: np.random.Generator, model: ObjectModel, area: _Area, config: TableShelfConfig) -> PlacedObject:
    # The gripper has to fit over the lying target: no plan grasps an object flat on its largest face.
    limit = config.max_opening - config.opening_margin
    poses = [pose for pose in resting_poses(model) if pose.level_width <= limit]
    poses = poses or [pose for pose in resting_poses(model) if graspable_by_part(model, pose, limit)]
    resting = _draw_resting(rng, poses, config.landing_weight)
    draws = area.draw(rng, resting)
    draws.inside &= np.linalg.norm(area.center + draws.positions, axis=1) <= config.pick_reach
    pose = area.put(resting, draws)
    if pose is None:
        raise SceneError(f"no place for {model.name!r} on the pick area of {config.pick_size} m; raise pick_size")
    return PlacedObject(model, pose)


def _place_goal(rng: np.random.Generator, model: ObjectModel, board: _Area, config: TableShelfConfig) -> Pose:
    resting = upright_pose(model)
    assert resting is not None, "the config checks that targets stand upright"
    across = resting.level_axis
    facing = np.pi / 2 - np.arctan2(across[1], across[0]) + np.pi * rng.integers(0, 2, _TRIES)
    yaws = facing + rng.uniform(-config.goal_yaw, config.goal_yaw, _TRIES)
    draws = board.turned(rng, resting, yaws, config.goal_wall_gap)
    # Local x runs from the front edge to the back wall.
    draws.positions[:, 0] = np.minimum(
        draws.low[:, 0] + rng.uniform(*config.goal_depth, _TRIES), board.size[0] / 2 - draws.footprints[..., 0].max(1)
    )
    pose = board.put(resting, draws)
    if pose is None:
        raise SceneError(f"no place for {model.name!r} on the shelf of {config.shelf_inside} m; raise shelf_inside")
    return pose


def _scatter(
    rng: np.random.Generator,
    count: int,
    names: Sequence[str],
    area: _Area,
    choose: Callable[[ObjectModel], RestingPose | None],
) -> tuple[PlacedObject, ...]:
    """Place the first ``count`` named objects that fit, at random in the free part of an area."""
    placed: list[PlacedObject] = []
    for name in names[: count + _SPARE]:
        if len(placed) == count:
            break
        resting = choose(OBJECTS[name])
        assert resting is not None, "the config checks that shelf objects stand upright"
        pose = area.put(resting, area.draw(rng, resting))
        if pose is not None:
            placed.append(PlacedObject(OBJECTS[name], pose))
    return tuple(placed)


def _draw_resting(rng: np.random.Generator, poses: Sequence[RestingPose], weight: float) -> RestingPose:
    shares = np.array([pose.probability for pose in poses]) ** weight
    return poses[int(rng.choice(len(poses), p=shares / shares.sum()))]


def _shelf_area(config: TableShelfConfig) -> _Area:
    """The shelf's board. Local x points away from the robot, so the front edge has the least x."""
    width, depth = config.shelf_inside
    center = np.array(config.shelf_center)
    return _Area(center, _shelf_yaw(config), np.array([depth, width]), config.board_height, config.goal_gap)


def _shelf_yaw(config: TableShelfConfig) -> float:
    return float(np.arctan2(config.shelf_center[1], config.shelf_center[0]))


@lru_cache(maxsize=8)
def _fixtures(config: TableShelfConfig) -> tuple[Fixture, ...]:
    table = level_support("table", config.table_size, config.table_center, "table")
    inside, depth = config.shelf_inside
    t, low, yaw = config.shelf_thickness, config.board_height, _shelf_yaw(config)
    top = low + config.shelf_clearance
    # name, material, size along depth, width and height, centre in the shelf's frame
    parts = (
        ("shelf_board", "shelf", (depth, inside, t), (0, 0, low - t / 2)),
        ("shelf_roof", "shelf", (depth + t, inside + 2 * t, t), (t / 2, 0, top + t / 2)),
        ("shelf_left", "acrylic", (depth, t, top), (0, (inside + t) / 2, top / 2)),
        ("shelf_right", "acrylic", (depth, t, top), (0, -(inside + t) / 2, top / 2)),
        ("shelf_back", "shelf", (t, inside + 2 * t, top), ((depth + t) / 2, 0, top / 2)),
    )
    rotation, middle = about_z(yaw), np.array([*config.shelf_center, 0.0])
    quaternion = shepperd_quaternion(rotation)
    shelf = (
        Fixture(name, np.array(size), to_pose(quaternion, middle + rotation @ offset), material, name == "shelf_board")
        for name, material, size, offset in parts
    )
    return (table, *shelf)
