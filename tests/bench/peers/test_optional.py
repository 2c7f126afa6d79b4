"""Import of optional libraries."""

from __future__ import annotations

import numpy as np
import pytest

from regrasp_bench.peers.optional import import_peer
from regrasp_gym.errors import BenchError


def test_a_missing_peer_names_the_extra() -> None:
    assert import_peer("numpy") is np
    with pytest.raises(BenchError, match=r"regrasp-gym\[bench\]"):
        import_peer("no_such_peer")
