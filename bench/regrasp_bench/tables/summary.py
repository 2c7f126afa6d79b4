"""Figures that several summaries have in common, and how tables show them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from regrasp_gym.reports.report import Record

NOTHING = "–"
"""Cell of a table without a value."""


def completed(records: Sequence[Record]) -> list[Record]:
    """Records of the trials that did not crash."""
    return [record for record in records if "crashed" not in record]


def seed_range(records: Sequence[Record]) -> list[int]:
    """Seeds of the first and of the last trial; empty without trials."""
    return [records[0]["trial"], records[-1]["trial"]] if records else []


def queries_of(scenes: Sequence[Record]) -> list[Record]:
    """Queries of all scenes, each with its seed and its number in the scene."""
    return [
        {"seed": scene["trial"], "number": i, **query}
        for scene in scenes
        for i, query in enumerate(scene.get("queries", ()))
    ]


def causes(failed: Sequence[Record]) -> dict[str, int]:
    """Number of failures by cause, most frequent first."""
    return dict(Counter(record["cause"] for record in failed).most_common())


def median(values: Sequence[float] | Float[np.ndarray, " N"]) -> float | None:
    """Median; None without values."""
    return float(np.median(values)) if len(values) else None


def mean(values: Sequence[float]) -> float | None:
    """Mean; None without values."""
    return float(np.mean(values)) if len(values) else None


def median_and_p90(values: Sequence[float], prefix: str = "") -> dict[str, float]:
    """Median and 90 % quantile, by name."""
    return {f"{prefix}median": float(np.median(values)), f"{prefix}p90": float(np.quantile(values, 0.9))}


def milliseconds(seconds: float | None, digits: int) -> str:
    """Cell with a time."""
    return NOTHING if seconds is None else f"{1e3 * seconds:.{digits}f}"


def percent(part: int, whole: int, interval: tuple[float, float], digits: int = 0, interval_digits: int = 0) -> str:
    """Cell with a share in percent, and its 95 % interval."""
    if not whole:
        return NOTHING
    low, high = (f"{100 * end:.{interval_digits}f}" for end in interval)
    return f"{100 * part / whole:.{digits}f} ({low}–{high})"
