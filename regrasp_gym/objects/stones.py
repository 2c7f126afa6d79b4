"""Random quarry stones: convex polyhedra with flat facets to rest on, a function of a seed and a `StoneConfig`.

A stone is the intersection of half-spaces whose planes touch a random superellipsoid, or cut a little off it. Half a
tonne is typical of dry stone walls built by excavators: Johns et al., "A framework for robotic excavation and dry stone
construction using on-site materials", Science Robotics 2023, doi 10.1126/scirobotics.abp9758. The density is granite's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import HalfspaceIntersection

from regrasp_gym.checks import check_names, check_positive, check_ranges, check_seed
from regrasp_gym.errors import SceneError
from regrasp_gym.geometry.facets import find_facets
from regrasp_gym.objects.model import Contact, ObjectModel, solid
from regrasp_gym.objects.stone_looks import TONES, rough_stone

KINDS = ("slab", "block", "wedge", "boulder")
"""Shapes that stones come in."""

VERTEX_RANGE = (12, 60)
"""Least and most corners of a stone."""

HARD = Contact(solref=(0.004, 1.0), solimp=(0.98, 0.995, 0.001), solmix=20.0)
"""Stiff enough that a resting stone of one tonne does not tremble."""

FRICTION = 0.7
"""Sliding friction of stone on stone; dry rock joints have 0.6 to 0.85 (Byerlee, Pure Appl. Geophys. 1978)."""

_SMALLEST_FACET = 0.012
"""Facets with a smaller share of the surface are left out: nothing rests on them, and their edges would be short."""

_TRIES = 200


@dataclass(frozen=True)
class StoneConfig:
    """Limits of random stones. Lengths in metres, masses in kilograms, ranges inclusive.

    Attributes:
        kinds: shapes to draw from, a subset of `KINDS`, all equally likely.
        mass: least and greatest; drawn uniformly, then the stone is scaled to it.
        density: kg/m³.
        least_width: range of the least distance between two parallel planes that enclose the stone.
        largest_extent: greatest distance between two corners.
    """

    kinds: tuple[str, ...] = KINDS
    mass: tuple[float, float] = (150.0, 950.0)
    density: float = 2600.0
    least_width: tuple[float, float] = (0.3, 0.95)
    largest_extent: float = 1.5

    def __post_init__(self) -> None:
        check_names(self, "kinds", known=KINDS)
        check_ranges(self, "mass", "least_width")
        check_positive(self, "mass", "least_width", "density", "largest_extent")


def stone(seed: int, config: StoneConfig | None = None, name: str = "stone", tone: str | None = None) -> ObjectModel:
    """The stone of a seed with its look. The arguments are those of `bare_stone`."""
    return dressed(bare_stone(seed, config, name, tone), seed)


def dressed(bare: ObjectModel, seed: int) -> ObjectModel:
    """``bare``, the stone of a seed, with the look of the same seed."""
    facets = find_facets(bare.pieces[0])
    look_rng = _look_rng(seed)
    look_rng.choice(list(TONES))
    look = rough_stone(look_rng, facets.triangles, facets.normals[facets.facet], bare.label.removesuffix(" stone"))
    return replace(bare, looks=(look,), rgba=look.rgba)


def bare_stone(
    seed: int, config: StoneConfig | None = None, name: str = "stone", tone: str | None = None
) -> ObjectModel:
    """Shape and mass of the stone of a seed, without its look, which would take half the time.

    Args:
        seed: a non-negative integer. The shape depends on it and on ``config`` alone.
        config: the default one if None.
        name: name of the object.
        tone: colour, a key of `regrasp_gym.objects.stone_looks.TONES`, drawn if None. The label is ``f"{tone} stone"``.

    Returns:
        An object of one convex piece with 12 to 60 corners, origin at the centre of mass.

    Raises:
        SceneError: negative seed, unknown tone, or no stone found within the limits of ``config``.
    """
    config = config or StoneConfig()
    check_seed(seed, "stone")
    rng = np.random.default_rng([seed, 0x570E])
    tone = tone or str(_look_rng(seed).choice(list(TONES)))
    if tone not in TONES:
        raise SceneError(f"unknown tone {tone!r}; the tones are {', '.join(TONES)}")
    for _ in range(_TRIES):
        mass = rng.uniform(*config.mass)
        made = _polyhedron(_planes(rng, str(rng.choice(config.kinds))), mass / config.density)
        if made is None:
            continue
        corners, normals = made
        if _within(corners, normals, config):
            break
    else:
        raise SceneError(
            f"no stone of seed {seed} with mass {config.mass} kg has a least width within {config.least_width} m and a "
            f"largest extent of at most {config.largest_extent} m; widen these limits"
        )
    return solid(name, f"{tone} stone", mass, [corners], friction=FRICTION, contact=HARD)


def _look_rng(seed: int) -> np.random.Generator:
    return np.random.default_rng([seed, 0x570E]).spawn(1)[0]


def _within(corners: np.ndarray, normals: np.ndarray, config: StoneConfig) -> bool:
    width = np.ptp(corners @ normals.T, axis=0).min()
    extent = np.linalg.norm(corners[:, None] - corners, axis=2).max()
    low, high = config.least_width
    return bool(low <= width <= high and extent <= config.largest_extent) and (
        VERTEX_RANGE[0] <= len(corners) <= VERTEX_RANGE[1]
    )


def _planes(rng: np.random.Generator, kind: str) -> Float[np.ndarray, "F 4"]:
    """Half-spaces n·x + d ≤ 0 about the origin, rows (n, d), in units of the largest half axis."""
    if kind == "boulder":
        axes = np.array([1.0, rng.uniform(0.72, 1.0), rng.uniform(0.58, 0.9)])
        normals = _spread(rng, int(rng.integers(15, 27)), 0.25)
        distance = _support(normals, axes, rng.uniform(2.0, 3.2)) * rng.uniform(0.93, 1.0, len(normals))
        return np.column_stack([normals, -distance])
    flat = {"slab": (0.36, 0.55), "block": (0.6, 0.95), "wedge": (0.55, 0.85)}[kind]
    axes = np.array([1.0, rng.uniform(0.62, 0.98), rng.uniform(*flat)])
    jitter = np.tile([0.12, 0.12, 0.05], 2)[:, None]
    sides = np.concatenate([np.eye(3), -np.eye(3)]) + jitter * rng.normal(size=(6, 3))
    if kind == "wedge":
        turn, lean = rng.uniform(0, 2 * np.pi), np.tan(rng.uniform(0.2, 0.45))
        sides[2, :2] += lean * np.array([np.cos(turn), np.sin(turn)])
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    distance = np.abs(sides * axes).max(axis=1)
    # Edges and corners break off: planes at a slant to the sides, a little inside the box's corners.
    chips = _spread(rng, int(rng.integers(7, 15)), 0.5)
    chips = chips[np.abs(chips).max(axis=1) < 0.93]
    cut = _support(chips, axes, np.inf) * rng.uniform(0.7, 0.93, len(chips))
    return np.column_stack([np.concatenate([sides, chips]), -np.concatenate([distance, cut])])


def _support(normals: np.ndarray, axes: np.ndarray, exponent: float) -> Float[np.ndarray, " F"]:
    """Support function of the superellipsoid Σ|xᵢ/aᵢ|^p = 1: the dual norm of a∘n, for p = ∞ that of a box."""
    dual = 1.0 if np.isinf(exponent) else exponent / (exponent - 1)
    return np.linalg.norm(normals * axes, ord=dual, axis=1)


def _spread(rng: np.random.Generator, count: int, jitter: float) -> Float[np.ndarray, "count 3"]:
    """Unit directions spread over the sphere (Fibonacci), each moved a little, all turned at random."""
    k = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    radius = np.sqrt(1 - z**2)
    directions = np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z])
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    directions = directions @ turn.T + jitter * rng.normal(size=(count, 3)) * np.sqrt(4 / count)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _polyhedron(planes: np.ndarray, volume: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Corners and normals of the intersection without its smallest facets, scaled to the given volume (m³)."""
    for _ in range(4):
        corners = HalfspaceIntersection(planes, np.zeros(3)).intersections
        facets = find_facets(corners)
        if len(facets.points) < len(corners):
            return None
        share = facets.areas / facets.areas.sum()
        if share.min() >= _SMALLEST_FACET:
            return corners * (volume / facets.volume) ** (1 / 3), facets.normals
        large = facets.normals[share >= _SMALLEST_FACET]
        planes = planes[(planes[:, :3] @ large.T).max(axis=1) > 1 - 1e-9]
        if len(planes) < 6:
            return None
    return None
