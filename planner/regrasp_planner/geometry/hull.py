"""Exact convex hulls on the host: vertices, facets, mass properties and width of a solid polyhedron."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError

from regrasp_planner.errors import GeometryError

BUCKETS = (8, 16, 32, 64, 128, 256)
"""Numbers of vertices that bodies are padded to, so that few shapes are ever compiled."""


def bucket_size(count: int) -> int:
    """Smallest bucket that holds ``count``; beyond the last one, the next multiple of it."""
    for size in BUCKETS:
        if count <= size:
            return size
    return -(-count // BUCKETS[-1]) * BUCKETS[-1]


def checked_points(points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    """``points`` as (N, 3) float64.

    Raises:
        GeometryError: wrong shape, fewer than 4 points, or not finite.
    """
    array = np.asarray(points, float)
    if array.ndim != 2 or array.shape[1] != 3:
        raise GeometryError(f"vertices have shape {array.shape}; give an (N, 3) array in metres")
    if len(array) < 4:
        raise GeometryError(f"{len(array)} vertices span no volume; give at least 4 that are not in one plane")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if len(bad):
        raise GeometryError(f"vertex {bad[0]} is {array[bad[0]]}; remove the {len(bad)} vertices that are not finite")
    return array


def qhull(points: Float[np.ndarray, "N 3"]) -> ConvexHull:
    """Qhull's triangulated hull of checked points.

    Raises:
        GeometryError: the points span no volume.
    """
    points = checked_points(points)
    spread = points - points.mean(axis=0)
    extents = np.linalg.svd(spread, compute_uv=False) / np.sqrt(len(points))
    if extents[2] <= 1e-7 * extents[0]:
        raise GeometryError(
            f"the {len(points)} vertices lie in one plane, line or point (spread {extents} m): zero volume; "
            "give a solid, or thicken it"
        )
    try:
        return ConvexHull(points)
    except QhullError as error:
        reason = str(error).splitlines()[0]
        raise GeometryError(f"the {len(points)} vertices have no hull with volume ({reason}); give a solid") from error


def solid_center(points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " 3"]:
    """Centre of mass of the uniform solid hull of the points, (3,) metres.

    Raises:
        GeometryError: the points span no volume.
    """
    hull = qhull(points)
    inside = hull.points[hull.vertices].mean(axis=0)
    corners = hull.points[hull.simplices] - inside
    volumes = np.abs(np.linalg.det(corners))
    return inside + (volumes[:, None] * corners.sum(axis=1)).sum(axis=0) / (4 * volumes.sum())


def reduced_hull(points: Float[np.ndarray, "N 3"], max_vertices: int) -> tuple[Float[np.ndarray, "K 3"], float]:
    """At most ``max_vertices`` vertices of the hull, and how far (metres) a left-out vertex is from their hull at most.

    Vertices are added one by one, always the one farthest outside of the hull so far.

    Raises:
        GeometryError: the points span no volume, or ``max_vertices`` is below 4.
    """
    if max_vertices < 4:
        raise GeometryError(f"max_vertices is {max_vertices}; a body needs at least 4")
    hull = qhull(points)
    vertices = hull.points[hull.vertices]
    if len(vertices) <= max_vertices:
        return vertices, 0.0
    chosen = _first_simplex(vertices)
    growing = ConvexHull(vertices[chosen], incremental=True)
    while len(chosen) < max_vertices:
        outside = (vertices @ growing.equations[:, :3].T + growing.equations[:, 3]).max(axis=1)
        outside[chosen] = -np.inf
        farthest = int(outside.argmax())
        chosen.append(farthest)
        growing.add_points(vertices[farthest : farthest + 1])
    kept = vertices[chosen]
    final = ConvexHull(kept)
    left = np.setdiff1d(np.arange(len(vertices)), chosen)
    slack = _distance_to_triangles(vertices[left], kept[final.simplices]).max()
    return kept[final.vertices], float(slack)


def _first_simplex(vertices: Float[np.ndarray, "N 3"]) -> list[int]:
    """Indices of four vertices that span a large tetrahedron."""
    first = int(np.linalg.norm(vertices - vertices.mean(axis=0), axis=1).argmax())
    second = int(np.linalg.norm(vertices - vertices[first], axis=1).argmax())
    axis = vertices[second] - vertices[first]
    third = int(np.linalg.norm(np.cross(vertices - vertices[first], axis), axis=1).argmax())
    normal = np.cross(axis, vertices[third] - vertices[first])
    fourth = int(np.abs((vertices - vertices[first]) @ normal).argmax())
    return [first, second, third, fourth]


def _distance_to_triangles(
    points: Float[np.ndarray, "N 3"], triangles: Float[np.ndarray, "T 3 3"]
) -> Float[np.ndarray, " N"]:
    """Distance (N,) of each point from the nearest of the triangles."""
    best = np.full(len(points), np.inf)
    for triangle in triangles:
        origin, edge_1, edge_2 = triangle[0], triangle[1] - triangle[0], triangle[2] - triangle[0]
        offset = points - origin
        gram = np.array([[edge_1 @ edge_1, edge_1 @ edge_2], [edge_1 @ edge_2, edge_2 @ edge_2]])
        weights = np.linalg.solve(gram, np.stack([offset @ edge_1, offset @ edge_2]))
        inside = (weights[0] >= 0) & (weights[1] >= 0) & (weights.sum(axis=0) <= 1)
        foot = offset - weights[0][:, None] * edge_1 - weights[1][:, None] * edge_2
        distance = np.where(inside, np.linalg.norm(foot, axis=1), np.inf)
        for i in range(3):
            start, along = triangle[i], triangle[(i + 1) % 3] - triangle[i]
            share = np.clip((points - start) @ along / (along @ along), 0, 1)
            distance = np.minimum(distance, np.linalg.norm(points - start - share[:, None] * along, axis=1))
        best = np.minimum(best, distance)
    return best
