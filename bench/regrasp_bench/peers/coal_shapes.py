"""Exact collision checks of many poses at once, with coal.

Boxes along the axes of both bodies give lower bounds of distances for a whole batch in a few array operations. Coal
checks only pairs that may be too close, one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull

from regrasp_bench.peers.optional import import_peer
from regrasp_planner import ConvexBody

_CHUNK = 500


@dataclass(frozen=True, eq=False)
class Shape:
    """A convex body for coal: its core as a polytope, and its sweep, which is added to every margin.

    Attributes:
        radius: radius of the sweep, metres.
        center, half: (3,) centre and half sides of the swept body's bounding box, metres.
        geometry: coal's polytope of the core.
    """

    radius: float
    center: Float[np.ndarray, " 3"]
    half: Float[np.ndarray, " 3"]
    geometry: Any

    @classmethod
    def of(cls, body: ConvexBody) -> Shape:
        """The exact hull of the body's vertices, swept."""
        coal = import_peer("coal")
        points = np.asarray(body.hull_vertices(), float)
        cloud = coal.StdVec_Vec3s()
        cloud.extend(list(points))
        low, high, radius = points.min(0), points.max(0), float(body.radius)
        return cls(radius, (low + high) / 2, (high - low) / 2 + radius, coal.Convex.convexHull(cloud, False, ""))


def polytope(points: Float[np.ndarray, "N 3"]) -> Any:
    """Coal's convex polytope with these points and the triangles of their hull."""
    coal = import_peer("coal")
    vertices, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    vertices.extend(list(points))
    triangles.extend([coal.Triangle(*map(int, corners)) for corners in ConvexHull(points).simplices])
    return coal.Convex(vertices, triangles)


@dataclass(frozen=True, eq=False)
class PosedShapes:
    """Shapes at poses: S shapes, each at one pose, or at one pose in each of N states.

    Attributes:
        shapes: S shapes.
        rotations: (*N, S, 3, 3).
        positions: (*N, S, 3) metres.
    """

    shapes: Sequence[Shape]
    rotations: Float[np.ndarray, "*N S 3 3"]
    positions: Float[np.ndarray, "*N S 3"]

    def rows(self, chosen: Bool[np.ndarray, " N"]) -> PosedShapes:
        """The chosen states."""
        return PosedShapes(self.shapes, self.rotations[chosen], self.positions[chosen])


def keeps_margins(
    moving: PosedShapes,
    still: PosedShapes,
    margins: Float[np.ndarray, "A B"] | float,
    pairs: Int[np.ndarray, "P 2"] | None = None,
) -> Bool[np.ndarray, " N"]:
    """Which of N states of the moving shapes keep their margins from the still ones.

    Args:
        moving: A shapes in N states.
        still: B shapes, at one pose each or in the same N states.
        margins: (A, B) least distances, metres; pairs with ``-inf`` are not checked.
        pairs: (P, 2) indices of the pairs to check; all if None.
    """
    count = len(moving.positions)
    if pairs is None:
        pairs = np.stack(np.meshgrid(np.arange(len(moving.shapes)), np.arange(len(still.shapes)), indexing="ij"), -1)
        pairs = pairs.reshape(-1, 2)
    margins = np.broadcast_to(np.asarray(margins, float), (len(moving.shapes), len(still.shapes)))
    kept = margins[pairs[:, 0], pairs[:, 1]]
    pairs, kept = pairs[np.isfinite(kept)], kept[np.isfinite(kept)]
    free = np.ones(count, bool)
    if len(pairs) == 0:
        return free
    a, b = pairs.T
    check = _Checks(moving.shapes, still.shapes, pairs, kept)
    moves = still.positions.ndim == 3
    for begin in range(0, count, _CHUNK):
        rows = slice(begin, begin + _CHUNK)
        of_b = (still.rotations[rows], still.positions[rows]) if moves else (still.rotations, still.positions)
        bound = _bounds(
            moving.rotations[rows][:, a],
            moving.positions[rows][:, a],
            np.array([shape.center for shape in moving.shapes])[a],
            np.array([shape.half for shape in moving.shapes])[a],
            of_b[0][..., b, :, :],
            of_b[1][..., b, :],
            np.array([shape.center for shape in still.shapes])[b],
            np.array([shape.half for shape in still.shapes])[b],
        )
        near = bound - kept
        for i in np.flatnonzero(near.min(1) < 0):
            row = begin + i
            poses_b = (still.rotations[row], still.positions[row]) if moves else (still.rotations, still.positions)
            open_ = np.flatnonzero(near[i] < 0)
            for k in open_[np.argsort(near[i][open_])]:
                if check(k, moving.rotations[row], moving.positions[row], *poses_b):
                    free[row] = False
                    break
    return free


class _Checks:
    """Coal's test of one pair at a time. Its requests are made in advance."""

    def __init__(self, moving: Sequence[Shape], still: Sequence[Shape], pairs: np.ndarray, margins: np.ndarray) -> None:
        coal = import_peer("coal")
        self.pairs = pairs
        self.transform = coal.Transform3s
        self.result = coal.CollisionResult()
        self.tests = [coal.ComputeCollision(moving[a].geometry, still[b].geometry) for a, b in pairs]
        self.requests = [coal.CollisionRequest() for _ in pairs]
        for request, margin, (a, b) in zip(self.requests, margins, pairs, strict=True):
            request.security_margin = float(margin) + moving[a].radius + still[b].radius

    def __call__(
        self, k: int, turns_a: np.ndarray, shifts_a: np.ndarray, turns_b: np.ndarray, shifts_b: np.ndarray
    ) -> bool:
        a, b = self.pairs[k]
        self.result.clear()
        self.tests[k](
            self.transform(turns_a[a], shifts_a[a]),
            self.transform(turns_b[b], shifts_b[b]),
            self.requests[k],
            self.result,
        )
        return self.result.isCollision()


def _bounds(
    turn_a: np.ndarray,
    shift_a: np.ndarray,
    center_a: np.ndarray,
    half_a: np.ndarray,
    turn_b: np.ndarray,
    shift_b: np.ndarray,
    center_b: np.ndarray,
    half_b: np.ndarray,
) -> Float[np.ndarray, "N P"]:
    """Lower bounds of the distances of P pairs of boxes in N states, from the gaps along the axes of both boxes."""
    back = np.swapaxes(turn_b, -1, -2)
    relative = back @ turn_a
    apart = (back @ (shift_a + _turned(turn_a, center_a) - shift_b)[..., None])[..., 0] - center_b
    size = np.abs(relative)
    gap_b = np.abs(apart) - _turned(size, half_a) - half_b
    gap_a = np.abs(_turned(np.swapaxes(relative, -1, -2), apart)) - _turned(np.swapaxes(size, -1, -2), half_b) - half_a
    return np.maximum(_distance(gap_a), _distance(gap_b))


def _turned(rotation: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return (rotation @ vector[..., None])[..., 0]


def _distance(gap: np.ndarray) -> np.ndarray:
    widest = gap.max(-1)
    return np.where(widest > 0, np.sqrt((np.maximum(gap, 0.0) ** 2).sum(-1)), widest)
