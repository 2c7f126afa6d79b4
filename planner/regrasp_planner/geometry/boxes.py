"""Bounding boxes of bodies, and lower bounds of their distances: the broad phase of every search."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from regrasp_planner.geometry.support import ConvexBody


def box_distance(gap: Sequence[Array]) -> Array:
    """Distance of boxes whose gaps along three axes are given; the largest gap where all are negative (overlap)."""
    widest = jnp.maximum(jnp.maximum(gap[0], gap[1]), gap[2])
    apart = jnp.sqrt(sum(jnp.maximum(part, 0.0) ** 2 for part in gap))
    return jnp.where(widest > 0, apart, widest)


def box_bounds(
    turn_a: Float[Array, "3 3 P N"],
    turn_b: Float[Array, "3 3 P N"],
    shift: Float[Array, "3 P N"],
    half_a: Float[Array, "3 P 1"],
    half_b: Float[Array, "3 P 1"],
) -> Float[Array, "P N"]:
    """Lower bound of the distance of two boxes: the larger of the gaps seen along the axes of either."""
    axes = range(3)
    relative = [[jnp.abs(sum(turn_a[k, i] * turn_b[k, j] for k in axes)) for j in axes] for i in axes]
    gaps_a = [
        jnp.abs(sum(turn_a[k, i] * shift[k] for k in axes)) - half_a[i] - sum(relative[i][j] * half_b[j] for j in axes)
        for i in axes
    ]
    gaps_b = [
        jnp.abs(sum(turn_b[k, j] * shift[k] for k in axes)) - half_b[j] - sum(relative[i][j] * half_a[i] for i in axes)
        for j in axes
    ]
    bounds = []
    for gaps in (gaps_a, gaps_b):
        largest = jnp.maximum(jnp.maximum(gaps[0], gaps[1]), gaps[2])
        outside = jnp.sqrt(sum(jnp.maximum(gap, 0.0) ** 2 for gap in gaps))
        bounds.append(jnp.where(largest > 0, outside, largest))
    return jnp.maximum(bounds[0], bounds[1])


class Boxes(NamedTuple):
    """Boxes along the axes of their bodies' frames: ``center`` (B, 3) and ``half`` sizes (B, 3), metres."""

    center: Float[np.ndarray, "B 3"]
    half: Float[np.ndarray, "B 3"]


def bounding_boxes(bodies: ConvexBody) -> Boxes:
    """Boxes about stacked bodies, along the axes of each body's own frame."""
    corners = [bodies[k].hull_vertices() for k in range(bodies.batch_size)]
    low, high = np.array([each.min(axis=0) for each in corners]), np.array([each.max(axis=0) for each in corners])
    return Boxes(0.5 * (low + high), 0.5 * (high - low) + np.asarray(bodies.radius)[:, None])
