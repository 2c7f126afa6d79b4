"""How many threads torch computes with."""

from __future__ import annotations

import os


def threads() -> int:
    """As many as OMP_NUM_THREADS says, else one.

    The networks here are small, and threads wait for one another: the longer, the more other processes (environments,
    loading of data) want the same cores.
    """
    return int(os.environ.get("OMP_NUM_THREADS", "1"))
