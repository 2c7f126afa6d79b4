"""``regrasp-bench``: measure the planner and the expert, or draw it; each name is one table, or all pictures."""

from __future__ import annotations

import sys

import gymnasium
import tyro
from rich.console import Console

from regrasp_bench.pictures.command import pictures
from regrasp_bench.tables.difficulty import difficulty
from regrasp_bench.tables.distance import distance
from regrasp_bench.tables.episodes import episodes
from regrasp_bench.tables.ik import ik
from regrasp_bench.tables.modules import modules
from regrasp_bench.tables.paper import table3, table4
from regrasp_bench.tables.path import path
from regrasp_bench.tables.plans import plans
from regrasp_bench.tables.releases import releases
from regrasp_bench.tables.simulation import simulation
from regrasp_bench.tables.stable_poses import stable_poses
from regrasp_gym.errors import EnvError


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
        "plans": plans,
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
