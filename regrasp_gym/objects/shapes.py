"""Point sets of convex shapes. Any length unit, z up."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

Points = Float[np.ndarray, "N 3"]


def box(x: float, y: float, z: float) -> Points:
    """(8, 3) corners of a box of full size x, y, z, centred at the origin."""
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)
    return signs * np.array([x, y, z]) / 2


def lathe(profile: Sequence[tuple[float, float]], sides: int) -> Points:
    """Rings of ``sides`` points at each (radius, height) of ``profile``; radius 0 gives one point."""
    angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    rings = []
    for radius, z in profile:
        if radius == 0:
            rings.append(np.array([[0.0, 0.0, z]]))
        else:
            rings.append(np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(sides, z)]))
    return np.concatenate(rings)


def rounded_rectangle(x: float, y: float, corner: float, per_corner: int = 3) -> Float[np.ndarray, "M 2"]:
    """Outline of a rectangle of full size x, y whose corners are rounded with radius ``corner``."""
    corner = min(corner, x / 2, y / 2)
    arcs = []
    for quarter in range(4):
        angle = np.pi / 2 * (quarter + np.linspace(0, 1, per_corner))
        sx, sy = [(1, 1), (-1, 1), (-1, -1), (1, -1)][quarter]
        middle = np.array([sx * (x / 2 - corner), sy * (y / 2 - corner)])
        arcs.append(middle + corner * np.column_stack([np.cos(angle), np.sin(angle)]))
    return np.concatenate(arcs)


def stacked(sections: Sequence[tuple[float, float, float, float]], per_corner: int = 3) -> Points:
    """Rounded rectangles (x, y, corner radius, z) on top of each other."""
    rings = []
    for x, y, corner, z in sections:
        outline = rounded_rectangle(x, y, corner, per_corner)
        rings.append(np.column_stack([outline, np.full(len(outline), z)]))
    return np.concatenate(rings)


def ellipsoid(x: float, y: float, z: float, count: int = 44) -> Points:
    """Points spread evenly over an ellipsoid of full size x, y, z around the origin.

    Scaled so that the hull has the ellipsoid's volume.
    """
    k = np.arange(count) + 0.5
    polar = np.arccos(1 - 2 * k / count)
    azimuth = np.pi * (1 + 5**0.5) * k
    sphere = np.column_stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)])
    scale = (4 * np.pi / 3 / ConvexHull(sphere).volume) ** (1 / 3)
    return sphere * scale * np.array([x, y, z]) / 2


def flattened(points: Points, depth: float) -> Points:
    """The hull of ``points`` without its lowest ``depth``, so that it stands on a flat base."""
    hull = ConvexHull(points)
    level = points[:, 2].min() + depth
    edges = {tuple(sorted((s[i], s[(i + 1) % 3]))) for s in hull.simplices for i in range(3)}
    crossings = []
    for a, b in sorted(edges):
        za, zb = points[a, 2], points[b, 2]
        if (za - level) * (zb - level) < 0:
            t = (level - za) / (zb - za)
            crossings.append(points[a] + t * (points[b] - points[a]))
    kept = np.concatenate([points[points[:, 2] >= level], np.array(crossings)])
    kept[np.isclose(kept[:, 2], level), 2] = level
    return kept[ConvexHull(kept).vertices]


def along_x(points: Points) -> Points:
    """Turned about y so that +z becomes +x."""
    return points @ np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])


def along_y(points: Points) -> Points:
    """Turned about x so that +z becomes +y."""
    return points @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
