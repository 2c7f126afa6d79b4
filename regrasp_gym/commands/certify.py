"""``regrasp-certify``: sort scenes into those in which one grasp suffices and those that need a regrasp."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import gymnasium
import tyro
from rich.console import Console
from rich.table import Table

import regrasp_gym
from regrasp_gym.benchmark.trials import Record, Trial, crashes, machine, run_trials
from regrasp_gym.errors import EnvError
from regrasp_gym.scenes.table_shelf import TableShelfConfig
from regrasp_gym.seeds import SPLITS, split_of

ENV = "regrasp_gym/PandaYCB-v0"

CRITERIA = {
    "panda_ycb_direct": "the planner finds a way with one grasp, and executing it succeeds",
    "panda_ycb_regrasp": "the planner finds no way with one grasp but one with a regrasp, and executing it succeeds",
}
"""What is listed, by name of the list."""


@dataclass(frozen=True)
class CertifyCommand:
    """Sort the scenes of regrasp_gym/PandaYCB-v0 by difficulty, and write the lists that its variants draw from.

    Each scene is planned with the strategy "repeated", which looks for a single grasp first, and the plan is executed
    in the simulation. An interrupted run goes on where it stopped, and more scenes can be added later: the lists are
    written from all scenes in RECORDS that were judged by this version.
    """

    first_seed: int = 0
    """First scene."""
    count: int = 300
    """How many scenes."""
    workers: int = 1
    """Processes."""
    records: Path = Path("outputs/certify.jsonl")
    """One JSON line per scene, appended to."""
    folder: Path = Path(regrasp_gym.__file__).parent / "seeds"
    """Where the lists are written; by default into the package."""


def main() -> None:
    """Entry point."""
    command = tyro.cli(CertifyCommand, prog="regrasp-certify")
    try:
        sys.exit(run(command))
    except (EnvError, OSError) as error:
        Console(stderr=True).print(f"regrasp-certify: {error}", style="red", markup=False, highlight=False)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


def run(command: CertifyCommand) -> int:
    """Judge the scenes and write the lists; 0, or 1 if scenes crashed."""
    setting = {"env": ENV, "strategy": "repeated", "scenes": scenes_digest(), "version": version("regrasp-gym")}
    seeds = range(command.first_seed, command.first_seed + command.count)
    records = run_trials(setting, seeds, _prepare, workers=command.workers, records=command.records, label="certifying")
    lists = {name: [record["trial"] for record in records if kind_of(record) == name] for name in CRITERIA}
    for name, scenes in lists.items():
        write_list(command.folder / f"{name}.json", name, scenes, seeds)
    _show(lists, records, command.folder)
    return 1 if crashes(records) else 0


def scenes_digest() -> str:
    """Digest of what the default scenes are made from: a list holds for these alone."""
    return hashlib.sha256(repr(TableShelfConfig()).encode()).hexdigest()[:16]


def kind_of(record: Record) -> str | None:
    """Name of the list that a judged scene belongs to, if any."""
    if "crashed" in record or not record["planned"] or not record["success"]:
        return None
    return "panda_ycb_direct" if len(record["stages"]) == 1 else "panda_ycb_regrasp"


def write_list(path: Path, name: str, scenes: Sequence[int], seeds: range) -> None:
    """Write a list of scenes by split, whole or not at all."""
    content = {
        "env": ENV,
        "criterion": CRITERIA[name],
        "judged": [seeds.start, seeds.stop],
        "scenes_digest": scenes_digest(),
        "versions": {package: version(package) for package in ("regrasp-gym", "mujoco", "jax", "numpy")},
        "machine": machine(),
        "scenes": {split: [seed for seed in sorted(scenes) if split_of(seed) == split] for split in SPLITS},
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".tmp")
    temporary.write_text(_compact(content))
    temporary.replace(path)


def _compact(content: Record) -> str:
    """Indented JSON with each list of numbers in one line."""
    lists = content["scenes"]
    text = json.dumps({**content, "scenes": {split: f"@{split}" for split in lists}, "judged": "@judged"}, indent=2)
    for split, scenes in lists.items():
        text = text.replace(f'"@{split}"', json.dumps(scenes))
    return text.replace('"@judged"', json.dumps(content["judged"])) + "\n"


def _prepare(setting: Record) -> Trial:
    # These load JAX, which only the processes that plan need.
    from regrasp_gym.benchmark.episodes import run_episode

    env = gymnasium.make(setting["env"])
    expert = regrasp_gym.PlannerExpert(env, setting["strategy"])
    return lambda seed: run_episode(env, expert, seed)


def _show(lists: dict[str, list[int]], records: Sequence[Record], folder: Path) -> None:
    console = Console()
    table = Table("list", *SPLITS, "scenes", title=f"{len(records)} scenes judged")
    for name, scenes in lists.items():
        by_split = [sum(split_of(seed) == split for seed in scenes) for split in SPLITS]
        table.add_row(name, *map(str, by_split), str(len(scenes)))
    console.print(table)
    left = len(records) - sum(map(len, lists.values()))
    console.print(f"{left} scenes in neither list: no plan, or its execution failed. Lists in {folder}", soft_wrap=True)
    for error, seeds in crashes(records).items():
        console.print(f"crashed: {error}, seeds {seeds}", style="red", markup=False, highlight=False)


if __name__ == "__main__":
    main()
