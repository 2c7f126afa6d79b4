"""Scenes of the Panda scenario: cluttered table, shelf with a free place in it, and a free patch of table in between.

A scene is a function of a seed and a `TableShelfConfig`, and of nothing else. The robot's base is the world's origin,
the table top is z = 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from regrasp_gym.errors import SceneError
from regrasp_gym.objects.model import ObjectModel
from regrasp_gym.objects.ycb import OBJECTS
from regrasp_gym.scenes.graspable import over_a_part
from regrasp_gym.scenes.resting import RestingPose, least_width, resting_poses, upright_pose
from regrasp_gym.scenes.scene import Fixture, PlacedObject, Pose, ReleasePatch

TARGETS = (
    "003_cracker_box",
    "004_sugar_box",
    "005_tomato_soup_can",
    "006_mustard_bottle",
    "010_potted_meat_can",
    "021_bleach_cleanser",
    "061_foam_brick",
    "065-a_cups",
    "077_rubiks_cube",
)
"""Objects that "upright" means something for and that the gripper can take."""

SHELF_OBJECTS = (
    *TARGETS,
    "013_apple",
    "014_lemon",
    "015_peach",
    "016_pear",
    "017_orange",
    "055_baseball",
    "056_tennis_ball",
)
"""Objects that may stand on the shelf: tall or round ones, nothing that lies."""

CLUTTER = tuple(name for name in OBJECTS if name != "025_mug")
"""Objects that may lie about. With the mug every seed would give another scene: it is for configs that name it."""

_TRIES = 32
"""Random placements tried for one object before another one is taken instead."""

_SPARE = 5
"""How many more objects than asked for are tried before a scene has to do with fewer."""


@dataclass(frozen=True)
class TableShelfConfig:
    """Everything about the scenes that can be tuned. Lengths in metres, angles in radians, ranges inclusive.

    Attributes:
        targets: names of the objects that may have to be moved.
        clutter: names of the objects that may lie around it on the table.
        shelf_objects: names of the objects that may stand on the shelf.
        table_clutter: least and most objects on the table besides the target.
        shelf_clutter: least and most objects on the shelf.
        pick_center, pick_size: rectangle on the table in which all objects start, middle and full size.
        pick_gap: least gap between two objects on the table, seen from above.
        pick_reach: largest horizontal distance of the target's start from the robot's base.
        landing_weight: a resting pose is drawn with its landing probability to this power: 1 as objects fall,
            0 all alike.
        release_center, release_size: rectangle on the table that is kept free, middle and full size.
        table_center, table_size: middle of the table top, and its length, width and thickness.
        shelf_center: middle of the shelf's board on the table plane. The opening faces the robot's base.
        shelf_inside: width and depth of the board between the walls.
        board_height: of the upper face of the board above the table.
        shelf_clearance: free height between the board and the roof.
        shelf_thickness: of all boards and walls.
        goal_gap: least gap between the target at its goal and its neighbours on the shelf, seen from above.
        goal_depth: least and most distance of the goal's footprint from the board's front edge.
        goal_wall_gap: least gap between the target at its goal and the side walls of the shelf.
        goal_yaw: at its goal the target is turned by up to ± this, at most a right angle, from where the gripper would
            take it straight from the front by its narrow sides, with either of these to the left.
        max_opening: of the gripper; targets must have less least width than this minus ``opening_margin``.
        opening_margin: see ``max_opening``.
    """

    targets: tuple[str, ...] = TARGETS
    clutter: tuple[str, ...] = CLUTTER
    shelf_objects: tuple[str, ...] = SHELF_OBJECTS
    table_clutter: tuple[int, int] = (3, 5)
    shelf_clutter: tuple[int, int] = (2, 3)
    pick_center: tuple[float, float] = (0.46, -0.31)
    pick_size: tuple[float, float] = (0.32, 0.30)
    pick_gap: float = 0.015
    pick_reach: float = 0.68
    landing_weight: float = 1.0
    release_center: tuple[float, float] = (0.48, 0.01)
    release_size: tuple[float, float] = (0.28, 0.24)
    table_center: tuple[float, float] = (0.32, 0.02)
    table_size: tuple[float, float, float] = (1.2, 1.5, 0.04)
    shelf_center: tuple[float, float] = (0.481, 0.481)
    shelf_inside: tuple[float, float] = (0.54, 0.30)
    board_height: float = 0.16
    shelf_clearance: float = 0.31
    shelf_thickness: float = 0.015
    goal_gap: float = 0.015
    goal_depth: tuple[float, float] = (0.03, 0.09)
    goal_wall_gap: float = 0.1
    goal_yaw: float = 0.5
    max_opening: float = 0.08
    opening_margin: float = 0.004

    def __post_init__(self) -> None:
        for name in (*self.targets, *self.clutter, *self.shelf_objects):
            if name not in OBJECTS:
                raise SceneError(f"unknown object {name!r}; the objects are {', '.join(OBJECTS)}")
        if not self.targets:
            raise SceneError("targets is empty; name at least one object")
        for name in ("table_clutter", "shelf_clutter"):
            low, high = getattr(self, name)
            if not 0 <= low <= high:
                raise SceneError(f"{name} is {(low, high)}; give the least and the most number of objects, 0 or more")
        for name in self.targets:
            check_target(OBJECTS[name], self)
        for name in self.shelf_objects:
            if upright_pose(OBJECTS[name]) is None:
                raise SceneError(f"shelf object {name!r} does not stand upright by itself; choose one that does")


@dataclass(frozen=True, eq=False)
class TableShelfScene:
    """One scene: pure data.

    Attributes:
        seed, config: what it was made from.
        target: the object to be moved and where it starts.
        goal_pose: (7,) where it is to come to rest, upright on the shelf.
        table_objects: the other objects on the table.
        shelf_objects: the objects on the shelf, upright.
        fixtures: table, boards and walls.
        release: the free patch of table.
    """

    seed: int
    config: TableShelfConfig
    target: PlacedObject
    goal_pose: Pose
    table_objects: tuple[PlacedObject, ...]
    shelf_objects: tuple[PlacedObject, ...]
    fixtures: tuple[Fixture, ...]
    release: ReleasePatch

    @property
    def others(self) -> tuple[PlacedObject, ...]:
        """All objects but the target."""
        return self.table_objects + self.shelf_objects

    @property
    def instruction(self) -> str:
        """The task in words."""
        return f"put the {self.target.model.label} upright on the shelf"


def check_target(model: ObjectModel, config: TableShelfConfig) -> None:
    """Raise `SceneError` if the object can not be a target: too wide for the gripper, or it does not stand upright.

    A hollow object may be wider than the gripper opens, if the gripper can take it by a part such as its rim.
    """
    width, limit = least_width(model), config.max_opening - config.opening_margin
    if width > limit and not any(over_a_part(model, pose, limit) for pose in resting_poses(model)):
        raise SceneError(
            f"target {model.name!r} is {1e3 * width:.0f} mm wide where it is thinnest; "
            f"the gripper takes at most {1e3 * limit:.0f} mm"
        )
    upright = upright_pose(model)
    if upright is None:
        raise SceneError(f"target {model.name!r} does not stand upright by itself; choose one that does")
    if upright.level_width > limit and not over_a_part(model, upright, limit):
        raise SceneError(
            f"target {model.name!r} is {1e3 * upright.level_width:.0f} mm wide where it is thinnest as it stands "
            f"upright; the gripper takes at most {1e3 * limit:.0f} mm"
        )


def make_scene(seed: int, config: TableShelfConfig | None = None) -> TableShelfScene:
    """The scene of a seed.

    The target and the clutter lie on the table in random resting poses, drawn by landing probability (the target's
    among those in which the gripper fits over it), at random yaw, and do not overlap seen from above (so neither do
    their hulls). On the shelf, upright objects at random yaw stand around the goal. Another object is taken instead
    of one for which no free place is found in a bounded number of tries, and where that does not help either there
    are fewer: a scene comes out for every seed.

    Args:
        seed: a non-negative integer.
        config: the default one if None.

    Raises:
        SceneError: negative seed, or a rectangle or board that is too small for the target alone.
    """
    config = config or TableShelfConfig()
    if seed < 0:
        raise SceneError(f"scene seed is {seed}; give a non-negative integer")
    rng = np.random.default_rng([seed, 0x7AB1E])
    # A stream of its own: what lies on the table does not change what stands on the shelf.
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


def footprint_gap(a: Float[np.ndarray, "*batch K 2"], b: Float[np.ndarray, "L 2"]) -> Float[np.ndarray, "*batch"]:
    """Gap between convex polygons along the best of their edge normals, metres; negative if they overlap.

    Never more than their distance (separating axis theorem). Corners counter-clockwise.
    """
    normals_a, normals_b = _outward(a), _outward(b)
    beyond_a = (np.einsum("...ki,li->...kl", normals_a, b)).min(axis=-1) - np.einsum("...ki,...ki->...k", normals_a, a)
    beyond_b = (np.einsum("li,...ki->...lk", normals_b, a)).min(axis=-1) - np.einsum("li,li->l", normals_b, b)
    return np.maximum(beyond_a.max(axis=-1), beyond_b.max(axis=-1))


def _outward(polygon: np.ndarray) -> np.ndarray:
    edges = np.roll(polygon, -1, axis=-2) - polygon
    normals = np.stack([edges[..., 1], -edges[..., 0]], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


class _Area:
    """A rectangle that objects are placed on, and what stands there already."""

    def __init__(self, center: np.ndarray, yaw: float, size: np.ndarray, height: float, gap: float) -> None:
        self.center, self.yaw, self.size, self.height, self.gap = center, yaw, size, height, gap
        self.placed: list[np.ndarray] = []

    def draw(self, rng: np.random.Generator, resting: RestingPose) -> _Draws:
        """Random turns, and random positions at which the footprint is inside the rectangle."""
        return self.turned(rng, resting, rng.uniform(-np.pi, np.pi, _TRIES))

    def turned(
        self, rng: np.random.Generator, resting: RestingPose, yaws: Float[np.ndarray, " T"], side_gap: float = 0.0
    ) -> _Draws:
        """Given turns, and random positions, a gap being left on the sides at least and greatest local y."""
        footprints = np.einsum("tij,kj->tki", np.moveaxis(_turn(yaws), -1, 0), resting.footprint)
        inside = self.size / 2 - [0.0, side_gap]
        low, high = -inside - footprints.min(axis=1), inside - footprints.max(axis=1)
        positions = low + rng.random((_TRIES, 2)) * (high - low)
        return _Draws(yaws, positions, footprints, low, (low <= high).all(axis=1))

    def put(self, resting: RestingPose, draws: _Draws) -> Pose | None:
        """Take the first draw that is inside and free; its pose in the world, or None if there is none."""
        polygons = draws.footprints + draws.positions[:, None]
        free = draws.inside.copy()
        for other in self.placed:
            free &= footprint_gap(polygons, other) >= self.gap
        if not free.any():
            return None
        k = int(free.argmax())
        self.placed.append(polygons[k])
        world = self.center + _turn(self.yaw) @ draws.positions[k]
        return _pose(_about_z(self.yaw + draws.yaws[k]) @ resting.rotation, [*world, self.height + resting.height])


@dataclass(eq=False)
class _Draws:
    """T random placements: turns (T,), positions (T, 2), footprints (T, K, 2) turned only, least positions (T, 2)."""

    yaws: np.ndarray
    positions: np.ndarray
    footprints: np.ndarray
    low: np.ndarray
    inside: np.ndarray


def _place_target(rng: np.random.Generator, model: ObjectModel, area: _Area, config: TableShelfConfig) -> PlacedObject:
    # As it lies, the gripper has to fit over it: an object flat on its largest face can not be taken by any plan.
    limit = config.max_opening - config.opening_margin
    poses = [pose for pose in resting_poses(model) if pose.level_width <= limit]
    poses = poses or [pose for pose in resting_poses(model) if over_a_part(model, pose, limit)]
    resting = _draw_resting(rng, poses, config.landing_weight)
    draws = area.draw(rng, resting)
    draws.inside &= np.linalg.norm(area.center + draws.positions, axis=1) <= config.pick_reach
    pose = area.put(resting, draws)
    if pose is None:
        raise SceneError(f"no place for {model.name!r} on the pick area of {config.pick_size} m; make it larger")
    return PlacedObject(model, pose)


def _place_goal(rng: np.random.Generator, model: ObjectModel, board: _Area, config: TableShelfConfig) -> Pose:
    resting = upright_pose(model)
    assert resting is not None, "the config has checked that its targets stand upright"
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
        raise SceneError(f"no place for {model.name!r} on the shelf of {config.shelf_inside} m; make it larger")
    return pose


def _scatter(
    rng: np.random.Generator,
    count: int,
    names: Sequence[str],
    area: _Area,
    choose: Callable[[ObjectModel], RestingPose | None],
) -> tuple[PlacedObject, ...]:
    """Place ``count`` of the named objects, the first ones that fit, at random in what is free of an area."""
    placed: list[PlacedObject] = []
    for name in names[: count + _SPARE]:
        if len(placed) == count:
            break
        resting = choose(OBJECTS[name])
        assert resting is not None, "the config has checked that its shelf objects stand upright"
        pose = area.put(resting, area.draw(rng, resting))
        if pose is not None:
            placed.append(PlacedObject(OBJECTS[name], pose))
    return tuple(placed)


def _draw_resting(rng: np.random.Generator, poses: Sequence[RestingPose], weight: float) -> RestingPose:
    shares = np.array([pose.probability for pose in poses]) ** weight
    return poses[int(rng.choice(len(poses), p=shares / shares.sum()))]


def _shelf_area(config: TableShelfConfig) -> _Area:
    """The shelf's board; local x points away from the robot, so that the front edge is at the least x."""
    width, depth = config.shelf_inside
    center = np.array(config.shelf_center)
    return _Area(center, _shelf_yaw(config), np.array([depth, width]), config.board_height, config.goal_gap)


def _shelf_yaw(config: TableShelfConfig) -> float:
    return float(np.arctan2(config.shelf_center[1], config.shelf_center[0]))


@lru_cache(maxsize=8)
def _fixtures(config: TableShelfConfig) -> tuple[Fixture, ...]:
    length, width, thick = config.table_size
    table = Fixture(
        "table",
        np.array([length, width, thick]),
        _pose(np.eye(3), [*config.table_center, -thick / 2]),
        "table",
        support=True,
    )
    inside, depth = config.shelf_inside
    t, low, yaw = config.shelf_thickness, config.board_height, _shelf_yaw(config)
    top = low + config.shelf_clearance
    # name, material, size along depth, width and height, middle in the shelf's frame
    parts = (
        ("shelf_board", "shelf", (depth, inside, t), (0, 0, low - t / 2)),
        ("shelf_roof", "shelf", (depth + t, inside + 2 * t, t), (t / 2, 0, top + t / 2)),
        ("shelf_left", "acrylic", (depth, t, top), (0, (inside + t) / 2, top / 2)),
        ("shelf_right", "acrylic", (depth, t, top), (0, -(inside + t) / 2, top / 2)),
        ("shelf_back", "shelf", (t, inside + 2 * t, top), ((depth + t) / 2, 0, top / 2)),
    )
    rotation, middle = _about_z(yaw), np.array([*config.shelf_center, 0.0])
    shelf = (
        Fixture(name, np.array(size), _pose(rotation, middle + rotation @ offset), material, name == "shelf_board")
        for name, material, size, offset in parts
    )
    return (table, *shelf)


def _turn(yaw: float | np.ndarray) -> Float[np.ndarray, "2 2 *batch"]:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s], [s, c]])


def _about_z(yaw: float) -> Float[np.ndarray, "3 3"]:
    rotation = np.eye(3)
    rotation[:2, :2] = _turn(yaw)
    return rotation


def _pose(rotation: np.ndarray, position: Sequence[float] | np.ndarray) -> Pose:
    """wxyz_xyz with w ≥ 0 of a rotation matrix and a position (Shepperd's method: the largest component first)."""
    r = rotation
    squares = np.array([np.trace(r), r[0, 0], r[1, 1], r[2, 2]])
    largest = int(squares.argmax())
    if largest == 0:
        quaternion = np.array([1 + squares[0], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    else:
        i, j, k = largest - 1, largest % 3, (largest + 1) % 3
        quaternion = np.empty(4)
        quaternion[0] = r[k, j] - r[j, k]
        quaternion[1 + i] = 1 + r[i, i] - r[j, j] - r[k, k]
        quaternion[1 + j] = r[j, i] + r[i, j]
        quaternion[1 + k] = r[k, i] + r[i, k]
    quaternion /= np.linalg.norm(quaternion)
    return np.concatenate([quaternion if quaternion[0] >= 0 else -quaternion, np.asarray(position, float)])
