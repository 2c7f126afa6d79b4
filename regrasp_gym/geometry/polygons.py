"""Convex polygons in the plane: gaps between them and margins inside them. Corners are counter-clockwise."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def half_planes(
    polygon: Float[np.ndarray, "*batch K 2"],
) -> tuple[Float[np.ndarray, "*batch K 2"], Float[np.ndarray, "*batch K"]]:
    """Outward unit normals (*batch, K, 2) and offsets (*batch, K) of a polygon's edges."""
    edges = np.roll(polygon, -1, axis=-2) - polygon
    normals = np.stack([edges[..., 1], -edges[..., 0]], axis=-1)
    normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    return normals, (normals * polygon).sum(axis=-1)


def clearance(polygon: Float[np.ndarray, "K 2"], points: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch"]:
    """Distance (metres) of points in a polygon from its nearest edge; negative outside."""
    normals, offsets = half_planes(polygon)
    return (offsets - points @ normals.T).min(axis=-1)


def footprint_gap(a: Float[np.ndarray, "*batch K 2"], b: Float[np.ndarray, "L 2"]) -> Float[np.ndarray, "*batch"]:
    """Largest gap (metres) between polygons along their edge normals; negative if they overlap.

    At most their distance (separating axis theorem).
    """
    gaps, _, _ = _edge_gaps(a, b)
    return gaps.max(axis=-1)


def slide_apart(
    moving: Float[np.ndarray, "T K 2"], ways: Float[np.ndarray, "T 2"], fixed: Float[np.ndarray, "L 2"], gap: float
) -> Float[np.ndarray, " T"]:
    """Distances to slide polygons until their `footprint_gap` to another is, and stays, at least ``gap``.

    Args:
        moving: (T, K, 2) polygons, metres.
        ways: (T, 2) unit directions to slide in.
        fixed: (L, 2) polygon, metres.
        gap: least gap, metres.

    Returns:
        (T,) least distances ≥ 0, metres.
    """
    gaps, fixed_normals, moving_normals = _edge_gaps(moving, fixed)
    speed = np.concatenate(
        [ways @ fixed_normals.T, -np.einsum("tki,ti->tk", moving_normals, ways)],
        axis=1,
    )
    parting = speed > 1e-9
    needed = np.where(parting, (gap - gaps) / np.where(parting, speed, 1.0), np.inf)
    return np.maximum(needed.min(axis=1), 0.0)


def _edge_gaps(
    a: Float[np.ndarray, "*batch K 2"], b: Float[np.ndarray, "L 2"]
) -> tuple[Float[np.ndarray, "*batch L+K"], Float[np.ndarray, "L 2"], Float[np.ndarray, "*batch K 2"]]:
    """Gaps along the outward edge normals of b, then of a, and these normals."""
    normals_b, offsets_b = half_planes(b)
    normals_a, offsets_a = half_planes(a)
    beyond_b = (a @ normals_b.T).min(axis=-2) - offsets_b
    beyond_a = (normals_a @ b.T).min(axis=-1) - offsets_a
    return np.concatenate([beyond_b, beyond_a], axis=-1), normals_b, normals_a
