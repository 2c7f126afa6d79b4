"""Buckets: arrays are padded to a few sizes, so that few shapes are ever compiled."""

from __future__ import annotations

from collections.abc import Sequence

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
