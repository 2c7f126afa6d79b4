"""Exact convex hulls on the host: vertices, facets, mass properties and width of a solid polyhedron."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from regrasp_planner.errors import GeometryError


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
    return center_of_mass(qhull(points))


def center_of_mass(hull: ConvexHull) -> Float[np.ndarray, " 3"]:
    """Centre of mass of the uniform solid hull, (3,) metres."""
    inside = hull.points[hull.vertices].mean(axis=0)
    corners = hull.points[hull.simplices] - inside
    volumes = np.abs(_dot(corners[:, 0], _cross(corners[:, 1], corners[:, 2])))
    return inside + (volumes @ corners.sum(axis=1)) / (4 * volumes.sum())


@dataclass(frozen=True)
class MassProperties:
    """Of a uniform solid.

    Attributes:
        volume: m³.
        center: (3,) centre of mass, metres.
        inertia: (3, 3) inertia about the centre of mass for unit mass, m².
    """

    volume: float
    center: Float[np.ndarray, " 3"]
    inertia: Float[np.ndarray, "3 3"]


def mass_properties(points: Float[np.ndarray, "N 3"]) -> MassProperties:
    """Volume, centre of mass and inertia per mass of the uniform solid hull of the points.

    The hull is cut into tetrahedra from an interior point; a tetrahedron with a corner at the origin and the others
    at v_i has second moment ∫ r rᵀ = V/20 (Σ v_i v_iᵀ + (Σ v_i)(Σ v_i)ᵀ).

    Raises:
        GeometryError: the points are no solid.
    """
    hull = qhull(points)
    center = center_of_mass(hull)
    corners = hull.points[hull.simplices] - center
    volumes = np.abs(_dot(corners[:, 0], _cross(corners[:, 1], corners[:, 2]))) / 6
    sums = corners.sum(axis=1)
    second = np.einsum("t,tki,tkj->ij", volumes, corners, corners) + np.einsum("t,ti,tj->ij", volumes, sums, sums)
    second /= 20 * volumes.sum()
    return MassProperties(float(volumes.sum()), center, np.trace(second) * np.eye(3) - second)


@dataclass(frozen=True)
class Facets:
    """Facets of a convex hull, coplanar triangles merged, seen from a point inside.

    Attributes:
        normals: (F, 3) outward unit normals.
        heights: (F,) distance of the facet's plane from the point, metres.
        margins: (F,) signed distance, within the plane, of the point's foot from the nearest boundary edge, metres:
            positive inside of the facet, negative when the solid would topple if it stood on it.
        topples_to: (F,) the neighbour over the edge that the foot lies farthest beyond; the facet itself if none.
        edges: (E, 2) facets on both sides of each edge of the hull (each edge once).
        edge_ends: (E, 2, 3) both ends of each edge, seen from the point, metres.
        passes: (E,) greatest height of the point above the ground while the solid rolls over the edge from one facet
            to the other, metres.
    """

    normals: Float[np.ndarray, "F 3"]
    heights: Float[np.ndarray, " F"]
    margins: Float[np.ndarray, " F"]
    topples_to: Int[np.ndarray, " F"]
    edges: Int[np.ndarray, "E 2"]
    edge_ends: Float[np.ndarray, "E 2 3"]
    passes: Float[np.ndarray, " E"]


def facets(hull: ConvexHull, point: Float[np.ndarray, " 3"], coplanar: float = 1e-5) -> Facets:
    """Facets of a hull about an interior ``point`` (3,); neighbours within ``coplanar`` radians are merged."""
    triangle_normals, neighbors = hull.equations[:, :3], hull.neighbors
    count = len(neighbors)
    apart = triangle_normals[:, None] - triangle_normals[neighbors]
    flat = _dot(apart, apart) < coplanar**2
    if flat.any():
        rows, columns = np.nonzero(flat)
        graph = coo_matrix((np.ones(len(rows)), (rows, neighbors[rows, columns])), shape=(count, count))
        number, facet_of = connected_components(graph, directed=False)
    else:
        number, facet_of = count, np.arange(count)
    first = np.zeros(number, int)
    first[facet_of[::-1]] = np.arange(count)[::-1]
    normals = triangle_normals[first]
    heights = -(hull.equations[first, 3] + normals @ point)

    corners = hull.points[hull.simplices] - point
    start, end = corners[:, [1, 2, 0]], corners[:, [2, 0, 1]]
    along = end - start
    inward = _cross(triangle_normals[:, None], along)
    slack = -np.sign(_dot(corners - start, inward)) * _dot(start, inward) / np.sqrt(_dot(inward, inward))
    other = facet_of[neighbors]
    inner = other == facet_of[:, None]
    slack[inner] = np.inf

    margins = np.full(number, np.inf)
    least = slack.min(axis=1)
    np.minimum.at(margins, facet_of, least)
    topples_to = np.arange(number)
    worst = slack.argmin(axis=1)
    leaves = np.flatnonzero((least == margins[facet_of]) & (least < 0))
    topples_to[facet_of[leaves]] = other[leaves, worst[leaves]]

    triangle, side = np.nonzero(~inner & (np.arange(count)[:, None] < neighbors))
    edges = np.stack([facet_of[triangle], other[triangle, side]], axis=1)
    a, d = start[triangle, side], along[triangle, side]
    ends = np.stack([a, end[triangle, side]], axis=1)
    foot = a - (_dot(a, d) / _dot(d, d))[:, None] * d
    # On the arc between the two normals the height is foot·x: it peaks inside if the foot lies between them.
    first_normal, second_normal = normals[edges[:, 0]], normals[edges[:, 1]]
    cosine = _dot(first_normal, second_normal)
    to_first, to_second = _dot(foot, first_normal), _dot(foot, second_normal)
    peaks = (to_second > cosine * to_first) & (to_first > cosine * to_second)
    passes = np.where(peaks, np.sqrt(_dot(foot, foot)), np.maximum(to_first, to_second))
    return Facets(normals, heights, margins, topples_to, edges, ends, passes)


def _dot(a: Float[np.ndarray, "*n 3"], b: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
    return np.einsum("...i,...i->...", a, b)


def _cross(a: Float[np.ndarray, "*n 3"], b: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Cross product; numpy's own takes twice as long for a few hundred vectors."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


def minimal_width(points: Float[np.ndarray, "N 3"]) -> float:
    """Least distance, metres, between two parallel planes that enclose the points.

    It is attained between a facet and a vertex or between two edges (Houle and Toussaint, IEEE PAMI 1988).

    Raises:
        GeometryError: the points are no solid.
    """
    hull = qhull(points)
    vertices = hull.points[hull.vertices]
    sides = hull.simplices[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2)
    ends = np.unique(np.sort(sides), axis=0)
    directions = hull.points[ends[:, 1]] - hull.points[ends[:, 0]]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    widths = np.ptp(hull.equations[:, :3] @ vertices.T, axis=1).min()
    for i, direction in enumerate(directions[:-1]):
        normals = np.cross(direction, directions[i + 1 :])
        lengths = np.linalg.norm(normals, axis=1)
        normals = normals[lengths > 1e-9] / lengths[lengths > 1e-9, None]
        if len(normals):
            widths = min(widths, np.ptp(normals @ vertices.T, axis=1).min())
    return float(widths)


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


CLIPPED = 2**15
"""Crossings of lines and planes worked out at once."""


def clip_lines(
    points: Float[np.ndarray, "K P 3"], direction: Float[np.ndarray, "K 3"], planes: Float[np.ndarray, "F 4"]
) -> tuple[Float[np.ndarray, "K P"], Float[np.ndarray, "K P"]]:
    """Where lines enter and leave the convex body n·x ≤ b.

    Args:
        points: P points of each of K bundles of parallel lines, metres.
        direction: one unit direction per bundle.
        planes: (n, b) of the body's facets.

    Returns:
        Distances from the points along the direction at which the lines enter and leave, metres; +∞ and −∞ where they
        miss the body.
    """
    enter, leave = np.empty(points.shape[:2]), np.empty(points.shape[:2])
    # A block of lines at a time, whose distances from all planes fit into the cache.
    step = max(1, CLIPPED // (points.shape[1] * len(planes)))
    for begin in range(0, len(points), step):
        block = slice(begin, begin + step)
        speed = (direction[block] @ planes[:, :3].T)[:, None]
        # A line along a plane, outside of it, leaves the body long before it could enter.
        speed = np.where(np.abs(speed) < 1e-9, 1e-12, speed)
        crossing = (planes[:, 3] - points[block] @ planes[:, :3].T) / speed
        enter[block] = np.where(speed < 0, crossing, -np.inf).max(axis=-1)
        leave[block] = np.where(speed > 0, crossing, np.inf).min(axis=-1)
    hit = enter < leave
    return np.where(hit, enter, np.inf), np.where(hit, leave, -np.inf)


def hull_planes(vertices: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "F 4"]:
    """Planes (n, b) of the facets of a hull, n·x ≤ b inside; facets that lie in one plane give it once."""
    planes = qhull(vertices).equations * [1.0, 1.0, 1.0, -1.0]
    return planes[np.unique(planes.round(7), axis=0, return_index=True)[1]]
