"""Datasets of the waving expert: their options, and what is known of them."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from regrasp_datasets.collect import CollectOptions

SCENARIOS = {
    "panda": ("regrasp_gym/PandaYCB-v0", 20, ("front", "wrist")),
    "excavator": ("regrasp_gym/ExcavatorStones-v0", 10, ("site", "cab")),
}
"""Environment, frames per second and cameras, by the robot's name."""

WANTED_SEEDS = [2, 3, 5, 7]
"""Seeds of the dataset. Seed 4 finds no plan, and only one of seeds 3 and 6, without a regrasp, is wanted."""


def options(root: Path, **changes) -> CollectOptions:
    common = {
        "root": root,
        "episodes": 4,
        "seed": 2,
        "workers": 2,
        "require_regrasp": 3,
        "image_size": 64,
        "keep_failures": True,
        "expert": "scripted_experts:WavingExpert",
    }
    return CollectOptions(**(common | changes))


def quiet() -> Console:
    return Console(quiet=True)
