"""Buckets: arrays are padded to a few sizes, so that few shapes are ever compiled."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Array, Float, Int

BUCKETS = (8, 16, 32, 64, 128, 256)
"""Numbers of vertices that bodies are padded to, so that few shapes are ever compiled."""


def bucket_size(count: int, buckets: Sequence[int] = BUCKETS) -> int:
    """Smallest bucket that holds ``count``; beyond the last one, the next multiple of it."""
    for size in buckets:
        if count <= size:
            return size
    return -(-count // buckets[-1]) * buckets[-1]


def bucket(count: int, buckets: Sequence[int], what: str) -> int:
    """Smallest bucket that holds ``count``; raises ``ValueError`` naming ``what`` if none does."""
    for size in buckets:
        if count <= size:
            return size
    raise ValueError(f"{count} {what}, more than the {buckets[-1]} that are supported")


def in_batches(
    measure: Callable[[Int[np.ndarray, " size"]], Float[Array, " size"]], count: int, size: int
) -> Float[np.ndarray, " count"]:
    """Values of ``measure`` for the indices 0 … count − 1, in calls of exactly ``size`` indices.

    The last call repeats the last index.
    """
    result = np.zeros(count)
    for begin in range(0, count, size):
        indices = np.minimum(np.arange(begin, begin + size), count - 1)
        result[begin : begin + size] = np.asarray(measure(indices))[: count - begin]
    return result
