"""Number of threads of torch."""

from __future__ import annotations

import os


def threads() -> int:
    """Value of OMP_NUM_THREADS, by default 1.

    The networks are small, so threads mostly wait for each other, longest when other processes need the same cores.
    """
    return int(os.environ.get("OMP_NUM_THREADS", "1"))
