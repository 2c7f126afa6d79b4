"""``regrasp-bench``: measure the planner and the expert, or draw it; each name is one table, or all pictures."""

from __future__ import annotations

import sys

import gymnasium
import tyro
from rich.console import Console

from regrasp_gym.benchmark.difficulty import difficulty
from regrasp_gym.benchmark.distance import distance
from regrasp_gym.benchmark.episodes import episodes
from regrasp_gym.benchmark.ik import ik
from regrasp_gym.benchmark.modules import modules
from regrasp_gym.benchmark.path import path
from regrasp_gym.benchmark.releases import releases
from regrasp_gym.benchmark.simulation import simulation
from regrasp_gym.benchmark.stable_poses import stable_poses
from regrasp_gym.benchmark.table3 import table3, table4
from regrasp_gym.errors import EnvError
from regrasp_gym.pictures.command import pictures


def main() -> None:
    """Entry point."""
    tables = {
        "difficulty": difficulty,
        "distance": distance,
        "episodes": episodes,
        "ik": ik,
        "modules": modules,
        "path": path,
        "pictures": pictures,
        "releases": releases,
        "simulation": simulation,
        "stable-poses": stable_poses,
        "table3": table3,
        "table4": table4,
    }
    try:
        tyro.extras.subcommand_cli_from_dict(tables, prog="regrasp-bench", description=__doc__)
    except (EnvError, gymnasium.error.Error, ValueError, OSError) as error:
        Console(stderr=True).print(f"regrasp-bench: {error}", style="red", markup=False, highlight=False)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
