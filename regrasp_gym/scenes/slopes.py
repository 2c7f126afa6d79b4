"""Scenes of the excavator: stones on two slopes, and a goal among or on the stones of the other slope.

A scene depends on a seed and a `SlopesConfig` alone. The swing axis is the world's z axis, the machine faces x, level
ground is z = 0. Everything is placed by geometry; nothing is simulated.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from regrasp_gym.checks import check_seed
from regrasp_gym.errors import SceneError
from regrasp_gym.geometry.polygons import clearance, slide_apart
from regrasp_gym.geometry.poses import mujoco_quaternion, plane_frame, to_pose, turn, turning_down
from regrasp_gym.objects.model import ObjectModel
from regrasp_gym.objects.stone_looks import TONES
from regrasp_gym.objects.stones import bare_stone, dressed, stone
from regrasp_gym.scenes.scene import Fixture, PlacedObject, ReleasePatch, Scene, level_support
from regrasp_gym.scenes.slope_resting import Plane, RestingStone, Seat, seats
from regrasp_gym.scenes.slopes_config import SlopesConfig

_DRAWS = 48
"""Random placements of one stone, tried at once."""

_STONES = 6
"""Stones tried for one place before the scene gets one fewer."""

_TARGETS = 12
"""Targets tried before the kind of goal may change; after twice as many the config counts as impossible."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SlopesScene(Scene):
    """A scene of the excavator.

    Attributes:
        pick_stones: the other stones on the pick slope.
        place_stones: the stones on the place slope.
        base: name of the stone under the goal, or None if the goal is on the slope.
        same_side: whether the target lies on the same facet at the start and at the goal.
    """

    config: SlopesConfig
    pick_stones: tuple[PlacedObject, ...]
    place_stones: tuple[PlacedObject, ...]
    base: str | None
    same_side: bool

    @property
    def others(self) -> tuple[PlacedObject, ...]:
        """All stones except the target."""
        return self.pick_stones + self.place_stones

    @property
    def instruction(self) -> str:
        """The task in words."""
        where = "the left slope"
        for thing in self.place_stones:
            if thing.name == self.base:
                where = f"the {thing.model.label} on the left slope"
        return f"put the {self.target.model.label} on {where}"


def make_scene(seed: int, config: SlopesConfig | None = None) -> SlopesScene:
    """The scene of a seed.

    No other stone has the target's tone of colour, and no other on the place slope has that of the stone under the
    goal, so the instruction is unambiguous. A stone without a free place after a bounded number of tries is left out,
    so every seed gives a scene.

    Args:
        seed: a non-negative integer.
        config: the default if None.

    Raises:
        SceneError: negative seed, or no target or goal found within the config; the message names the fields.
    """
    config = config or SlopesConfig()
    check_seed(seed, "scene")
    rng = np.random.default_rng([seed, 0x5709E])
    # Separate streams: stones on one slope do not change the other slope.
    pick_rng, place_rng = rng.spawn(2)
    tones = [str(tone) for tone in rng.permutation(list(TONES))]
    pick = _Slope.drawn(rng, "pick_slope", config.pick_azimuth, config)
    place = _Slope.drawn(rng, "place_slope", config.place_azimuth, config)
    start, goal, base = _target_and_goal(rng, pick, place, tones, config)
    pick.put(start)

    n_pick = int(pick_rng.integers(config.pick_stones[0], config.pick_stones[1] + 1))
    n_place = int(place_rng.integers(config.place_stones[0], config.place_stones[1] + 1))
    first = 1 if base is None else 2
    last = first + n_pick
    pick.surround(pick_rng, [f"stone_{k}" for k in range(first, last)], config.pick_gap, tones[1:])
    names = [f"stone_{k}" for k in range(last, last + n_place - len(place.stones))]
    place.surround(place_rng, names, config.goal_gap, tones[first:])
    return SlopesScene(
        seed=int(seed),
        config=config,
        target=start.object,
        goal_pose=goal.pose,
        pick_stones=tuple(pick.stones),
        place_stones=tuple(place.stones),
        base=None if base is None else base.model.name,
        same_side=goal.seat is start.seat,
        fixtures=(_ground(config), pick.fixture, place.fixture),
        release=ReleasePatch(np.array([*config.release_center, 0.0]), np.array(config.release_size) / 2),
    )


class _Slope:
    """An inclined surface and the stones on it."""

    def __init__(self, name: str, plane: Plane, outward: np.ndarray, config: SlopesConfig) -> None:
        self.name, self.plane, self.outward, self.config = name, plane, outward, config
        self.stones: list[PlacedObject] = []
        self.taken: list[np.ndarray] = []
        self.middle = np.zeros(2)

    @classmethod
    def drawn(cls, rng: np.random.Generator, name: str, azimuth: tuple[float, float], config: SlopesConfig) -> _Slope:
        where, distance = rng.uniform(*azimuth), rng.uniform(*config.slope_distance)
        inclination, falling = rng.uniform(*config.inclination), where + np.pi + rng.uniform(*config.downhill)
        height = rng.uniform(*config.lift) + config.slope_radius * np.sin(inclination)
        outward = np.array([np.cos(where), np.sin(where), 0.0])
        across = np.sin(inclination)
        normal = np.array([across * np.cos(falling), across * np.sin(falling), np.cos(inclination)])
        return cls(name, Plane(plane_frame(normal, outward), distance * outward + [0.0, 0.0, height]), outward, config)

    @property
    def fixture(self) -> Fixture:
        size = self.config.slope_size, self.config.slope_size, self.config.slope_thickness
        middle = self.plane.origin - self.config.slope_thickness / 2 * self.plane.rotation[:, 2]
        return Fixture(
            self.name, np.array(size), to_pose(mujoco_quaternion(self.plane.rotation), middle), "earth", support=True
        )

    def put(self, placed: RestingStone, *more: np.ndarray) -> None:
        """Occupy the footprint of the stone and of ``more`` world points; later stones gather around it."""
        points = np.concatenate([placed.footprint, *(self.plane.to_plane(points)[:, :2] for points in more)])
        self.taken.append(points[ConvexHull(points).vertices])
        self.middle = placed.position[:2]

    def near_middle(
        self, rng: np.random.Generator, model: ObjectModel, seat: Seat, spread: float, yaws: np.ndarray
    ) -> RestingStone | None:
        """The stone on this facet near the middle of the slope, at the first of the yaws that keeps it stable."""
        radius, azimuth = spread * np.sqrt(rng.random(len(yaws))), rng.uniform(-np.pi, np.pi, len(yaws))
        positions = radius[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
        return self._first(model, seat, yaws, positions)

    def surround(self, rng: np.random.Generator, names: list[str], gap: tuple[float, float], tones: list[str]) -> None:
        """Push new stones from random sides towards the last stone that was put, as long as they fit."""
        for name in names:
            for _ in range(_STONES):
                seed = _seed(rng)
                model = bare_stone(seed, self.config.stones, name, str(rng.choice(tones)))
                choice = seats(model)
                if not choice:
                    continue
                seat = choice[_order(rng, choice, self.config.landing_weight)[0]]
                azimuth, yaws = rng.uniform(-np.pi, np.pi, (2, _DRAWS))
                ways = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
                moving = np.einsum("tij,kj->tki", turn(yaws), seat.footprint) + self.middle
                least = rng.uniform(*gap)
                slid = np.max([slide_apart(moving, ways, other, least) for other in self.taken], axis=0)
                placed = self._first(model, seat, yaws, self.middle + slid[:, None] * ways)
                if placed is not None:
                    self.taken.append(placed.footprint)
                    self.stones.append(PlacedObject(dressed(model, seed), placed.pose))
                    break

    def _first(self, model: ObjectModel, seat: Seat, yaws: np.ndarray, positions: np.ndarray) -> RestingStone | None:
        """The first placement that is stable and inside the disc."""
        footprints = np.einsum("tij,kj->tki", turn(yaws), seat.footprint) + positions[:, None]
        good = np.linalg.norm(footprints, axis=2).max(axis=1) <= self.config.slope_radius
        good &= seat.margin(yaws, self.plane.fall) >= self.config.rest_margin
        if not good.any():
            return None
        k = int(good.argmax())
        return RestingStone(model, seat, self.plane, float(yaws[k]), np.array([*positions[k], seat.height]))


def _target_and_goal(
    rng: np.random.Generator, pick: _Slope, place: _Slope, tones: list[str], config: SlopesConfig
) -> tuple[RestingStone, RestingStone, RestingStone | None]:
    """The target at its start and at its goal, and the stone under the goal, if any."""
    same, on_top = rng.random() < config.same_side, rng.random() < config.on_top
    limit = config.max_opening - config.opening_margin
    start = None
    for attempt in range(2 * _TARGETS):
        # At first, prefer another target to another kind of goal.
        lenient = attempt >= _TARGETS
        model = stone(_seed(rng), config.target, "stone_0", tones[0])
        choice = [seat for seat in seats(model) if seat.width <= limit]
        if not choice:
            continue
        first = choice[_order(rng, choice, config.landing_weight)[0]]
        start = pick.near_middle(rng, model, first, config.target_spread, rng.uniform(-np.pi, np.pi, _DRAWS)) or start
        if start is None or start.model is not model:
            continue
        others = [choice[k] for k in _order(rng, choice, config.goal_landing_weight) if choice[k] is not first]
        wanted = [first] if same else others
        for_goal = wanted + [seat for seat in choice if seat not in wanted] if lenient else wanted
        if on_top:
            stacked = _goal_on_stone(rng, start, for_goal, place, tones[1], config)
            if stacked is not None:
                return start, *stacked
        if not on_top or lenient:
            for seat in for_goal:
                goal = place.near_middle(rng, model, seat, config.goal_spread, _goal_yaws(rng, start, seat, config))
                if goal is not None:
                    place.put(goal)
                    return start, goal, None
    if start is None:
        raise SceneError(
            f"no target of {config.target} lies on the pick slope with rest_margin {config.rest_margin} m, within "
            f"slope_radius {config.slope_radius} m and at most max_opening - opening_margin = {limit:.2f} m wide; "
            "change target or one of these"
        )
    raise SceneError(
        f"no goal on the place slope has rest_margin {config.rest_margin} m within slope_radius "
        f"{config.slope_radius} m; lower rest_margin or raise slope_radius"
    )


def _goal_on_stone(
    rng: np.random.Generator, start: RestingStone, for_goal: list[Seat], place: _Slope, tone: str, config: SlopesConfig
) -> tuple[RestingStone, RestingStone] | None:
    """The target on an upper facet of a new stone on the place slope, and that stone; None if none is found."""
    for _ in range(_STONES):
        model = stone(_seed(rng), config.base, "stone_1", tone)
        choice = seats(model)
        if not choice:
            continue
        under = choice[_order(rng, choice, config.landing_weight)[0]]
        base = place.near_middle(rng, model, under, config.goal_spread, rng.uniform(-np.pi, np.pi, _DRAWS))
        if base is None:
            continue
        for top, facet in _upper_facets(base, place.outward, config):
            for seat in for_goal:
                goal = _on_facet(rng, start, seat, base, top, facet, config)
                if goal is not None:
                    place.put(base, goal.points())
                    place.stones.append(base.object)
                    return goal, base
    return None


def _upper_facets(base: RestingStone, outward: np.ndarray, config: SlopesConfig) -> list[tuple[Plane, np.ndarray]]:
    """Planes and corners (K, 2) of the facets that may carry a goal, largest first."""
    rotation, position = base.plane.to_world(base.rotation, base.position)
    facets = base.seat.facets
    normals = facets.normals @ rotation.T
    found = []
    for k in np.flatnonzero(normals[:, 2] >= np.cos(config.top_inclination)):
        corners = facets.corners(int(k)) @ rotation.T + position
        plane = Plane(plane_frame(normals[k], outward), corners.mean(axis=0))
        if plane.origin[2] <= config.top_height:
            found.append((facets.areas[k], plane, plane.to_plane(corners)[:, :2]))
    return [(plane, corners) for _, plane, corners in sorted(found, key=lambda item: -item[0])]


def _on_facet(
    rng: np.random.Generator,
    start: RestingStone,
    seat: Seat,
    base: RestingStone,
    top: Plane,
    facet: np.ndarray,
    config: SlopesConfig,
) -> RestingStone | None:
    """The target flush on a facet of the base, neither of them tipping; None if that fails."""
    yaws = _goal_yaws(rng, start, seat, config)
    # Points of the facet vertically below the target's centre of mass.
    feet = rng.dirichlet(np.ones(len(facet)), len(yaws)) @ facet
    good = (clearance(facet, feet) >= config.top_margin) & (seat.margin(yaws, top.fall) >= config.top_margin)
    positions = np.column_stack([feet - seat.height * top.fall, np.full(len(yaws), seat.height)])
    centers = base.plane.to_plane(positions @ top.rotation.T + top.origin)
    share = start.model.mass / (start.model.mass + base.model.mass)
    both = share * centers + (1 - share) * base.position
    good &= clearance(base.contact, both[:, :2] + both[:, 2:] * base.plane.fall) >= config.top_margin
    if not good.any():
        return None
    k = int(good.argmax())
    return RestingStone(start.model, seat, top, float(yaws[k]), positions[k])


def _goal_yaws(
    rng: np.random.Generator, start: RestingStone, seat: Seat, config: SlopesConfig
) -> Float[np.ndarray, " T"]:
    """Yaws of the target on another facet: rolled onto it by the smallest rotation, then turned by ± ``goal_yaw``."""
    rolled = turning_down(start.rotation @ seat.normal) @ start.rotation @ seat.rotation.T
    turns = rng.uniform(*config.goal_yaw, _DRAWS) * rng.choice([-1.0, 1.0], _DRAWS)
    return np.arctan2(rolled[1, 0], rolled[0, 0]) + turns


def _order(rng: np.random.Generator, choice: list[Seat] | tuple[Seat, ...], weight: float) -> list[int]:
    """Random order of facets, drawn without replacement by their solid angles to the power ``weight``."""
    # Weighted sampling without replacement by exponential variables (Efraimidis and Spirakis 2006).
    rates = np.array([seat.solid_angle for seat in choice]) ** weight
    return np.argsort(rng.exponential(size=len(choice)) / rates).tolist()


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(2**31))


@lru_cache(maxsize=8)
def _ground(config: SlopesConfig) -> Fixture:
    return level_support("ground", (config.ground_size, config.ground_size, 1.0), (0.0, 0.0), "gravel")
