"""``regrasp-bench``: measure the planner and the expert, or draw them; each name is one table, or all pictures."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import tyro

from regrasp_bench.pictures.command import PicturesOptions, pictures
from regrasp_bench.tables.difficulty import DifficultyOptions, difficulty
from regrasp_bench.tables.distance import DistanceOptions, distance
from regrasp_bench.tables.episodes import EpisodesOptions, episodes
from regrasp_bench.tables.ik import IkOptions, ik
from regrasp_bench.tables.modules import ModulesOptions, modules
from regrasp_bench.tables.paper import Table3Options, Table4Options, table3, table4
from regrasp_bench.tables.path import PathOptions, path
from regrasp_bench.tables.plans import PlansOptions, plans
from regrasp_bench.tables.releases import ReleasesOptions, releases
from regrasp_bench.tables.simulation import SimulationOptions, simulation
from regrasp_bench.tables.stable_poses import StablePosesOptions, stable_poses
from regrasp_gym.reports.command_line import run_command

COMMANDS: dict[str, tuple[type, Callable[[Any], int]]] = {
    "difficulty": (DifficultyOptions, difficulty),
    "distance": (DistanceOptions, distance),
    "episodes": (EpisodesOptions, episodes),
    "ik": (IkOptions, ik),
    "modules": (ModulesOptions, modules),
    "path": (PathOptions, path),
    "pictures": (PicturesOptions, pictures),
    "plans": (PlansOptions, plans),
    "releases": (ReleasesOptions, releases),
    "simulation": (SimulationOptions, simulation),
    "stable-poses": (StablePosesOptions, stable_poses),
    "table3": (Table3Options, table3),
    "table4": (Table4Options, table4),
}
"""Options and work of each subcommand."""


def main() -> None:
    """Entry point: exits with 0 if done, 1 if trials crashed, 2 for wrong use, 130 for Ctrl-C."""
    options = {name: kind for name, (kind, _) in COMMANDS.items()}
    chosen = tyro.extras.subcommand_cli_from_dict(options, prog="regrasp-bench", description=__doc__)
    work = dict(COMMANDS.values())[type(chosen)]
    sys.exit(run_command("regrasp-bench", lambda: work(chosen), resume="the same command resumes"))
