"""A small dataset of lifts that all tests of training share."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

# The scripted expert is imported by name in worker processes, which take over this process's module path.
sys.path.insert(0, str(Path(__file__).parent))

LIFT = "regrasp_gym/PandaYCBLift-v0"


def collected(root, **options):
    """Collect lifts of the scripted expert."""
    from rich.console import Console

    from regrasp_datasets.collect import CollectOptions, collect

    chosen = CollectOptions(
        root=root, env=LIFT, control_mode="ee_delta", expert="scripted_lift:ScriptedLift", **{"images": False} | options
    )
    assert collect(chosen, Console(quiet=True)) == 0
    return root


@pytest.fixture(scope="session")
def lifts(tmp_path_factory):
    """Three lifts, vectors only."""
    pytest.importorskip("lerobot")
    return collected(tmp_path_factory.mktemp("lifts") / "dataset", episodes=3)
