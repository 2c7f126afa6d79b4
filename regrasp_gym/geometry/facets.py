"""Facets of a convex polyhedron: areas, solid angles, and margins against tipping.

The last bits of scenes depend on the rounding here: do not reorder arithmetic.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull

_COPLANAR = 1e-6
"""Largest distance (metres) from a facet's plane of the corners of its triangles."""


@dataclass(frozen=True, eq=False)
class Facets:
    """Facets of a convex polyhedron by their edges. Lengths in metres.

    Attributes:
        points: (N, 3) corners.
        normals: (F, 3) unit outward normals.
        facet: (T,) facet of each edge.
        edges: (T, 2) start and end corner of each edge, counter-clockwise from outside.
    """

    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "F 3"]
    facet: Int[np.ndarray, " T"]
    edges: Int[np.ndarray, "T 2"]

    @cached_property
    def triangles(self) -> Float[np.ndarray, "T 3 3"]:
        """(T, 3, 3) triangles of the surface: start and end of an edge, and the middle of its facet."""
        ends = self.points[self.edges]
        return np.concatenate([ends, _middles(ends, self.facet)[self.facet][:, None]], axis=1)

    @cached_property
    def areas(self) -> Float[np.ndarray, " F"]:
        """(F,) areas of the facets, square metres."""
        a, b, c = np.moveaxis(self.triangles, 1, 0)
        return np.bincount(self.facet, 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))

    @cached_property
    def volume(self) -> float:
        """Volume, cubic metres; the origin has to be inside."""
        return float(np.linalg.det(self.triangles).sum() / 6)

    @cached_property
    def solid_angles(self) -> Float[np.ndarray, " F"]:
        """(F,) solid angles from the origin, as shares of the sphere (Van Oosterom and Strackee, IEEE T-BME 1983)."""
        unit = self.triangles / np.linalg.norm(self.triangles, axis=2, keepdims=True)
        a, b, c = np.moveaxis(unit, 1, 0)
        below = 1 + (a * b).sum(axis=1) + (b * c).sum(axis=1) + (a * c).sum(axis=1)
        return np.bincount(self.facet, 2 * np.arctan2(np.linalg.det(unit), below)) / (4 * np.pi)

    @cached_property
    def edge_margins(self) -> Float[np.ndarray, " T"]:
        """(T,) distances of the origin, projected onto the facet, from its edges; negative beyond them."""
        a, b = np.moveaxis(self.points[self.edges], 1, 0)
        inward = np.cross(self.normals[self.facet], b - a)
        return -(inward * a).sum(axis=1) / np.linalg.norm(inward, axis=1)

    @cached_property
    def margins(self) -> Float[np.ndarray, " F"]:
        """(F,) least `edge_margins` of each facet: with the origin at the centre of mass, > 0 is stable."""
        return self._least(self.edge_margins)

    @cached_property
    def shortest_edges(self) -> Float[np.ndarray, " F"]:
        """(F,) length of the shortest edge of each facet."""
        a, b = np.moveaxis(self.points[self.edges], 1, 0)
        return self._least(np.linalg.norm(b - a, axis=1))

    def corners(self, facet: int) -> Float[np.ndarray, "K 3"]:
        """(K, 3) corners of a facet, counter-clockwise from outside."""
        return counter_clockwise(self.points[self.edges[self.facet == facet, 0]], self.normals[facet])

    def across(self, edge: int) -> int:
        """The facet on the other side of an edge."""
        start, end = self.edges[edge]
        return int(self.facet[(self.edges == (end, start)).all(axis=1)][0])

    def _least(self, of_edges: Float[np.ndarray, " T"]) -> Float[np.ndarray, " F"]:
        least = np.full(len(self.normals), np.inf)
        np.minimum.at(least, self.facet, of_edges)
        return least


def find_facets(points: Float[np.ndarray, "N 3"]) -> Facets:
    """The facets of the convex hull of points, in the order of their first triangles from Qhull."""
    hull = ConvexHull(points)
    if len(hull.vertices) < len(points):
        return find_facets(points[hull.vertices])
    # Qhull splits facets into triangles. Each belongs to the first one whose plane contains its corners.
    on_plane = np.abs(hull.equations[:, :3] @ points.T + hull.equations[:, 3:]) < _COPLANAR
    first, part = np.unique(on_plane[:, hull.simplices].all(axis=2).argmax(axis=0), return_inverse=True)
    normals = hull.equations[first, :3]
    # Neighbour k of a triangle is across the edge opposite corner k.
    which, k = np.nonzero(part[hull.neighbors] != part[:, None])
    edges = np.stack([hull.simplices[which, (k + 1) % 3], hull.simplices[which, (k + 2) % 3]], axis=1)
    facet = part[which]
    ends = points[edges]
    a, b, c = ends[:, 0], ends[:, 1], _middles(ends, facet)[facet]
    inward = (np.cross(b - a, c - a) * normals[facet]).sum(axis=1) < 0
    edges[inward] = edges[inward, ::-1]
    return Facets(points, normals, facet, edges)


def counter_clockwise(corners: Float[np.ndarray, "K 3"], normal: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "K 3"]:
    """Corners of a convex polygon in order around its normal, starting opposite the first one given."""
    middle = corners.mean(axis=0)
    across = (corners[0] - middle) / np.linalg.norm(corners[0] - middle)
    spokes = corners - middle
    return corners[np.argsort(np.arctan2(spokes @ np.cross(normal, across), spokes @ across))]


def _middles(ends: Float[np.ndarray, "T 2 3"], facet: Int[np.ndarray, " T"]) -> Float[np.ndarray, "F 3"]:
    count = np.bincount(facet)[:, None]
    return np.column_stack([np.bincount(facet, ends[:, 0, i] + ends[:, 1, i]) for i in range(3)]) / (2 * count)
