"""What a seed means does not change: scenes are those of version 0.1.0."""

import json

import pytest
from scene_digests import FILE, IDS, digests

import regrasp_gym  # noqa: F401


@pytest.mark.parametrize("env_id", IDS)
def test_a_seed_gives_the_scene_it_always_gave(env_id: str) -> None:
    expected = json.loads(FILE.read_text())[env_id]
    found = digests(env_id)
    changed = [seed for seed, (old, new) in enumerate(zip(expected, found, strict=True)) if old != new]
    assert not changed, f"the scenes of {env_id} have changed for the seeds {changed}: raise the id's version instead"


def test_every_id_has_its_digests() -> None:
    import gymnasium

    registered = {name for name in gymnasium.registry if name.startswith("regrasp_gym/")}
    assert registered == set(json.loads(FILE.read_text()))
