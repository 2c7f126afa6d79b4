"""The smallest of many distances, measuring only a few of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

Measure = Callable[[Int[np.ndarray, " L"], Int[np.ndarray, " L"]], Float[np.ndarray, " L"]]
"""Function of (rows, columns) that returns the exact values of these entries."""


def least_slack(
    bounds: Float[np.ndarray, "N P"], measure: Measure, cap: float = 0.0, floor: float = 0.0
) -> tuple[Float[np.ndarray, " N"], Int[np.ndarray, " N"]]:
    """Smallest value of each row, from lower bounds and as few measurements as possible.

    The entry with the lowest bound of each row is measured first, then every entry whose bound is below that value.

    Args:
        bounds: (N, P) lower bounds of the values: distance minus required distance of P pairs of bodies, metres.
        measure: returns the values themselves.
        cap: larger values are not resolved.
        floor: a row whose first value is below is settled; its result is that value, which may not be the smallest.

    Returns:
        (N,) values, cut at ``cap``, and (N,) the columns that attain them, −1 where no value is below ``cap``.
    """
    count = len(bounds)
    value, column = np.full(count, float(cap)), np.full(count, -1)

    def update(rows: Int[np.ndarray, " L"], columns: Int[np.ndarray, " L"]) -> None:
        measured = measure(rows, columns)
        # The last value written to a row counts, so the smallest is written last, and of equal ones the first.
        order = np.argsort(measured, kind="stable")[::-1]
        order = order[measured[order] < value[rows[order]]]
        value[rows[order]], column[rows[order]] = measured[order], columns[order]

    if bounds.size == 0:
        return value, column
    lowest = bounds.argmin(axis=1)
    rows = np.flatnonzero(bounds[np.arange(count), lowest] < cap)
    update(rows, lowest[rows])
    may_be_lower = (bounds < value[:, None]) & (value >= floor)[:, None]
    may_be_lower[rows, lowest[rows]] = False
    update(*np.nonzero(may_be_lower))
    return value, column
