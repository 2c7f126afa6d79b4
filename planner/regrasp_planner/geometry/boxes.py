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


Turns = Float[Array, "3 3 P N"] | Sequence[Sequence[Array]]
"""Rotation matrices, their entries first: one array, or rows of (P, N) arrays."""


def box_bounds(
    turn_a: Turns,
    turn_b: Turns,
    shift: Float[Array, "3 P N"] | Sequence[Array],
    half_a: Float[Array, "3 P 1"] | Float[np.ndarray, "3 P 1"],
    half_b: Float[Array, "3 P 1"] | Float[np.ndarray, "3 P 1"],
) -> Float[Array, "P N"]:
    """Lower bound of the distance of two boxes: the larger of the gaps seen along the axes of either.

    In the frame of A, the turned box of B lies in a box with half sizes |R| h. The distance of the two boxes there is
    a lower bound; so is the one in the frame of B.

    Args:
        turn_a, turn_b: rotations of the boxes.
        shift: from the centre of A to the centre of B, metres.
        half_a, half_b: half sizes, metres.
    """
    axes = range(3)
    relative = [[jnp.abs(sum(turn_a[k][i] * turn_b[k][j] for k in axes)) for j in axes] for i in axes]
    gaps_a = [
        jnp.abs(sum(turn_a[k][i] * shift[k] for k in axes)) - half_a[i] - sum(relative[i][j] * half_b[j] for j in axes)
        for i in axes
    ]
    gaps_b = [
        jnp.abs(sum(turn_b[k][j] * shift[k] for k in axes)) - half_b[j] - sum(relative[i][j] * half_a[i] for i in axes)
        for j in axes
    ]
    return jnp.maximum(box_distance(gaps_a), box_distance(gaps_b))


class Boxes(NamedTuple):
    """Boxes along the axes of their bodies' frames: ``center`` (B, 3) and ``half`` sizes (B, 3), metres."""

    center: Float[Array, "B 3"] | Float[np.ndarray, "B 3"]
    half: Float[Array, "B 3"] | Float[np.ndarray, "B 3"]


def core_boxes(bodies: ConvexBody) -> Boxes:
    """Boxes about the hulls of stacked bodies, without their sweep."""
    # The padding lies within the hulls.
    corners = np.asarray(bodies.vertices)
    low, high = corners.min(axis=1), corners.max(axis=1)
    return Boxes(0.5 * (low + high), 0.5 * (high - low))


def bounding_boxes(bodies: ConvexBody) -> Boxes:
    """Boxes about stacked bodies with their sweep."""
    core = core_boxes(bodies)
    return Boxes(core.center, core.half + np.asarray(bodies.radius)[:, None])
