from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from scenario_facts import Facts


@pytest.fixture(scope="module")
def env(facts: Facts) -> Iterator[gym.Env]:
    """An environment of each scenario in turn, with state observations and joint positions as actions."""
    made = facts.make()
    # Gymnasium's checker compares with the first reset, which a refused option would leave without a result.
    made.reset(seed=0)
    yield made
    made.close()


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder with nothing in it."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("REGRASP_CACHE_DIR", str(folder))
    return folder


@pytest.fixture(scope="session")
def angle() -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of an L profile, legs of 100 mm, 20 mm thick and 50 mm high: 56 % of its hull."""
    outline = np.array([[0, 0], [0.1, 0], [0.1, 0.02], [0.02, 0.02], [0.02, 0.1], [0, 0.1]])
    n = len(outline)
    vertices = np.concatenate([np.column_stack([outline, np.full(n, z)]) for z in (0.0, 0.05)])
    sides = [[i, (i + 1) % n, (i + 1) % n + n] for i in range(n)] + [[i, (i + 1) % n + n, i + n] for i in range(n)]
    caps = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]
    return vertices, np.array(sides + [c[::-1] for c in caps] + [[i + n for i in c] for c in caps])
