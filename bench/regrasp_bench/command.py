"""``regrasp-bench``: measure the planner and the expert, or draw them; each name is one table, or all pictures."""

from __future__ import annotations

import sys
from collections.abc import Callable
from operator import attrgetter
from typing import Any, get_type_hints

import tyro

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
from regrasp_gym.reports.command_line import run_command

BENCHMARKS = (difficulty, distance, episodes, ik, modules, path, plans, releases, simulation, stable_poses)
COMMANDS: dict[str, Callable[[Any], int]] = {
    work.__name__.replace("_", "-"): work
    for work in sorted((*BENCHMARKS, pictures, table3, table4), key=attrgetter("__name__"))
}
"""Work of each subcommand, a function of its options."""


def main() -> None:
    """Entry point: exits with 0 if done, 1 if trials crashed, 2 for wrong use, 130 for Ctrl-C."""
    works = {get_type_hints(work)["options"]: work for work in COMMANDS.values()}
    options = dict(zip(COMMANDS, works, strict=True))
    chosen = tyro.extras.subcommand_cli_from_dict(options, prog="regrasp-bench", description=__doc__)
    sys.exit(run_command("regrasp-bench", lambda: works[type(chosen)](chosen), resume="the same command resumes"))
