"""How many threads torch computes with."""

from __future__ import annotations

import os


def threads() -> int:
    """As many as OMP_NUM_THREADS says, else one.

    The networks here are small, and threads wait for one another: where another process takes a core (environments,
    loading of data), two threads have been seen to take forty times as long as one.
    """
    return int(os.environ.get("OMP_NUM_THREADS", "1"))
