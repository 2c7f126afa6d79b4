"""Shipped lists of scenes by difficulty, made by ``regrasp-certify``, and the splits of seeds for learning."""

from __future__ import annotations

import json
from functools import lru_cache
from importlib.resources import files

from regrasp_gym.errors import SceneError

SPLITS = ("train", "val", "test")
"""Scenes for training, validation and test. No scene is in two splits."""

FIRST_SEED = {"train": 0, "val": 500_000_000, "test": 1_000_000_000}
"""First seed of each split; collections start at 0."""


def split_of(scene_seed: int) -> str:
    """The split of a scene, by its seed alone."""
    return max((split for split in SPLITS if FIRST_SEED[split] <= scene_seed), key=FIRST_SEED.__getitem__)


@lru_cache(maxsize=8)
def read_seeds(name: str) -> dict[str, tuple[int, ...]]:
    """Scene seeds by split.

    Args:
        name: name of the list, a JSON file of this package.

    Raises:
        SceneError: the file cannot be read, or one of its splits is empty.
    """
    try:
        listed = json.loads((files("regrasp_gym.seeds") / f"{name}.json").read_text())["scenes"]
    except (OSError, ValueError, KeyError) as error:
        message = f"the list of scenes {name!r} cannot be read ({error}); make it with regrasp-certify"
        raise SceneError(message) from error
    seeds = {split: tuple(listed.get(split, ())) for split in SPLITS}
    for split, scenes in seeds.items():
        if not scenes:
            raise SceneError(f"the list of scenes {name!r} has no scenes for {split!r}; extend it with regrasp-certify")
    return seeds
