"""Times of calls."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np


def mean_seconds(call: Callable[[], object], times: int = 1) -> float:
    """Mean time of a call, over several calls."""
    began = time.perf_counter()
    for _ in range(times):
        call()
    return (time.perf_counter() - began) / times


def least_seconds(calls: Mapping[str, Callable[[], Any]], repeats: int = 1) -> dict[str, tuple[float, Any]]:
    """Least time of each call, and its result.

    The calls are timed in turn, so that a disturbance of the machine hits all alike. Each is made once before, untimed,
    to compile what it needs.
    """
    results = {name: call() for name, call in calls.items()}
    least = dict.fromkeys(calls, np.inf)
    for _ in range(repeats):
        for name, call in calls.items():
            least[name] = min(least[name], mean_seconds(call))
    return {name: (least[name], results[name]) for name in calls}
