"""Plates, bars and pins: the shapes that make up the excavator's visible surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from regrasp_gym.rendering.surfaces import Look, Rgba, faceted, joined, revolve, sweep
from regrasp_gym.robots.looks import Finish, Parts

PAINT: Rgba = (0.06, 0.40, 0.42, 1.0)
CREAM: Rgba = (0.90, 0.87, 0.78, 1.0)
DARK: Rgba = (0.16, 0.17, 0.18, 1.0)
TRACK: Rgba = (0.27, 0.25, 0.23, 1.0)
STEEL: Rgba = (0.62, 0.63, 0.65, 1.0)
CHROME: Rgba = (0.80, 0.81, 0.83, 1.0)
GLASS: Rgba = (0.13, 0.20, 0.25, 1.0)
LAMP: Rgba = (0.98, 0.97, 0.88, 1.0)

FINISHES: dict[str, Finish] = {
    "paint": (PAINT, 0.45, 0.5),
    "cream": (CREAM, 0.4, 0.5),
    "dark": (DARK, 0.25, 0.3),
    "track": (TRACK, 0.2, 0.2),
    "steel": (STEEL, 0.5, 0.5),
    "chrome": (CHROME, 0.9, 0.8),
    "glass": (GLASS, 0.9, 0.9),
    "lamp": (LAMP, 0.8, 0.8),
}
"""Finishes by name."""

Point = Sequence[float] | Float[np.ndarray, " 3"]
"""A point, (3,) metres."""

_AXES = {"x": (1, 2, 0), "y": (2, 0, 1), "z": (0, 1, 2)}


def merged(*parts: Parts) -> Parts:
    """All surfaces of several parts."""
    total: Parts = {}
    for part in parts:
        for finish, looks in part.items():
            total.setdefault(finish, []).extend(looks)
    return total


def box(low: Sequence[float], high: Sequence[float]) -> Look:
    """A box between two corners, metres."""
    corners = np.array([low, high], float)
    pick = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    return faceted(corners[pick, np.arange(3)])


def plate(outline: Sequence[tuple[float, float]], low: float, high: float, across: str = "y") -> Look:
    """A convex plate.

    Args:
        outline: corners in the plane of the other two axes, in the order x, y, z, metres.
        low, high: its extent along ``across``, metres.
        across: "x", "y" or "z".
    """
    points = np.asarray(outline, float)
    place = "xyz".index(across)
    return faceted(np.concatenate([np.insert(points, place, at, axis=1) for at in (low, high)]))


def frustum(low: Sequence[tuple[float, float]], high: Sequence[tuple[float, float]], bottom: float, top: float) -> Look:
    """The hull of one outline (x, y) at height ``bottom`` and another at ``top``, metres."""
    return faceted(np.concatenate([np.insert(np.asarray(o, float), 2, z, 1) for o, z in ((low, bottom), (high, top))]))


def pin(center: Point, radius: float, half: float, axis: str = "y", sides: int = 28) -> Look:
    """A cylinder about a coordinate axis, metres."""
    look = revolve([(0, -half), (radius, -half), (radius, half), (0, half)], sides, smooth=False)
    order = np.argsort(_AXES[axis])
    return look.rotated(np.eye(3)[:, order].T if axis == "z" else np.eye(3)[order]).shifted(np.asarray(center, float))


def bar(start: Point, end: Point, radius: float, sides: int = 16) -> Look:
    """A round bar from one point to another, metres."""
    path = np.array([start, end], float)
    along = path[1] - path[0]
    side = np.eye(3)[int(np.argmin(np.abs(along)))]
    return sweep(path, np.full((2, 2), radius), side, sides=sides)


def strut(start: Sequence[float], end: Sequence[float], half_y: float, half_z: float) -> Look:
    """A square bar, ``half_y`` along y and ``half_z`` across, metres."""
    path = np.array([start, end], float)
    side = np.array([0.0, 1.0, 0.0]) if abs(path[1, 1] - path[0, 1]) < 0.1 else np.array([1.0, 0.0, 0.0])
    return sweep(path, np.array([[half_y, half_z]] * 2), side, squareness=12.0, sides=32)


def pipe(points: Sequence[Sequence[float]], radius: float) -> Look:
    """Round bars from point to point, metres."""
    return joined([bar(a, b, radius, 10) for a, b in pairwise(points)])


def beam(points: Sequence[tuple[float, float]], half_heights: Sequence[float], half_width: float) -> Look:
    """A welded box beam that bends in the xz plane.

    Args:
        points: (x, z) of the centre line, metres.
        half_heights: half the height of the section at each point, metres.
        half_width: half the width along y, metres.
    """
    path = np.array([(x, 0.0, z) for x, z in points])
    sizes = np.array([(half_width, height) for height in half_heights])
    return sweep(path, sizes, np.array([0.0, 1.0, 0.0]), squareness=9.0, sides=40)


def stadium(radius: float, half: float, count: int) -> Float[np.ndarray, "count 3"]:
    """(count, 3) points (x, z, direction of travel in radians) evenly along a belt around two wheels at x = ±half."""
    straight, turn = 2 * half, np.pi * radius
    rows = []
    for s in np.arange(count) * (2 * straight + 2 * turn) / count:
        if s < straight:
            rows.append((s - half, -radius, 0.0))
        elif s < straight + turn:
            a = (s - straight) / radius
            rows.append((half + radius * np.sin(a), -radius * np.cos(a), a))
        elif s < 2 * straight + turn:
            rows.append((half - (s - straight - turn), radius, np.pi))
        else:
            a = (s - 2 * straight - turn) / radius
            rows.append((-half - radius * np.sin(a), radius * np.cos(a), np.pi + a))
    return np.array(rows)
