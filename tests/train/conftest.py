from __future__ import annotations

import pytest
from scripted_lift import collected


@pytest.fixture(scope="session")
def lifts(tmp_path_factory):
    """Three lifts, vectors only."""
    pytest.importorskip("lerobot")
    return collected(tmp_path_factory.mktemp("lifts") / "dataset", episodes=3)
