"""``regrasp-certify``: sort scenes into those in which one grasp suffices and those that need a regrasp."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import gymnasium
import tyro
from rich.console import Console
from rich.table import Table

import regrasp_gym
from regrasp_gym.errors import EnvError, SceneError
from regrasp_gym.reports.trials import Record, Trial, crashes, machine, read_records, run_trials, write_report
from regrasp_gym.scenes.table_shelf_config import TableShelfConfig
from regrasp_gym.seeds import FIRST_SEED, SPLITS, split_of

ENV = "regrasp_gym/PandaYCB-v0"

CRITERIA = {
    "panda_ycb_direct": "the planner finds a way with one grasp, and executing it succeeds",
    "panda_ycb_regrasp": "the planner finds no way with one grasp but one with regrasps, and executing it succeeds",
}
"""What is listed, by name of the list."""


@dataclass(frozen=True)
class CertifyCommand:
    """Sort the scenes of regrasp_gym/PandaYCB-v0 by difficulty, and write the lists that its variants draw from.

    Each scene is planned with the strategy "repeated", which looks for a single grasp first, and the plan is executed
    in the simulation. An interrupted run goes on where it stopped, and more scenes can be added later: the lists are
    written from all scenes in RECORDS that were judged by this version with this effort.
    """

    train: int = 300
    """How many scenes are judged for training: those from seed 0 on."""
    val: int = 75
    """How many for validation: those from seed 500,000,000 on."""
    test: int = 150
    """How many for the test: those from seed 1,000,000,000 on."""
    workers: int = 1
    """Processes."""
    records: Path = Path("outputs/certify.jsonl")
    """One JSON line per scene, appended to."""
    folder: Path = Path(regrasp_gym.__file__).parent / "seeds"
    """Where the lists are written; by default into the package."""
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None
    """Write the counts as JSON."""


def main() -> None:
    """Entry point."""
    command = tyro.cli(CertifyCommand, prog="regrasp-certify", description=CertifyCommand.__doc__)
    try:
        sys.exit(run(command))
    except (EnvError, OSError) as error:
        Console(stderr=True).print(f"regrasp-certify: {error}", style="red", markup=False, highlight=False)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


def run(command: CertifyCommand) -> int:
    """Judge the scenes and write the lists; 0, or 1 if scenes crashed.

    Raises:
        SceneError: a list would have no scene for one of the splits; none is written then.
    """
    setting = setting_of()
    counts = {"train": command.train, "val": command.val, "test": command.test}
    seeds = [FIRST_SEED[split] + k for split in SPLITS for k in range(counts[split])]
    asked = run_trials(setting, seeds, _prepare, workers=command.workers, records=command.records, label="certifying")
    judged = {r["trial"]: r for r in read_records(command.records) if r.get("setting") == setting}
    records = [judged[trial] for trial in sorted(judged)]
    lists = {name: [record["trial"] for record in records if kind_of(record) == name] for name in CRITERIA}
    for name, scenes in lists.items():
        empty = [split for split, seeds in by_split(scenes).items() if not seeds]
        if empty:
            raise SceneError(f"no scene for {name} in the split {empty[0]!r}: judge more with --{empty[0]}")
    for name, scenes in lists.items():
        write_list(command.folder / f"{name}.json", name, scenes, list(judged))
    _show(lists, records, command.folder)
    counted = {name: {split: len(seeds) for split, seeds in by_split(lists[name]).items()} for name in CRITERIA}
    write_report(command.json_file, {**setting, "judged": len(records), "listed": counted, "crashed": crashes(records)})
    return 1 if crashes(asked) else 0


def setting_of() -> Record:
    """What verdicts depend on: scenes, planner's effort and version."""
    # Loads JAX.
    from regrasp_planner import PlanOptions

    effort = hashlib.sha256(repr(PlanOptions()).encode()).hexdigest()[:16]
    versions = {"version": version("regrasp-gym"), "effort": effort}
    return {"env": ENV, "strategy": "repeated", "scenes": scenes_digest(), **versions}


def by_split(scenes: Sequence[int]) -> dict[str, list[int]]:
    """Scene seeds in order, by the split that they belong to."""
    return {split: [seed for seed in sorted(scenes) if split_of(seed) == split] for split in SPLITS}


def scenes_digest() -> str:
    """Digest of what the default scenes are made from: a list holds for these alone."""
    return hashlib.sha256(repr(TableShelfConfig()).encode()).hexdigest()[:16]


def kind_of(record: Record) -> str | None:
    """Name of the list that a judged scene belongs to, if any."""
    if "crashed" in record or not record["planned"] or not record["success"]:
        return None
    if len(record["stages"]) > 1:
        return "panda_ycb_regrasp"
    # Another plan was needed: the one grasp did not hold.
    return "panda_ycb_direct" if record["plans"] == 1 else None


def write_list(path: Path, name: str, scenes: Sequence[int], judged: Sequence[int]) -> None:
    """Write a list of scenes by split, whole or not at all."""
    content = {
        "env": ENV,
        "criterion": CRITERIA[name],
        "judged": {split: len(seeds) for split, seeds in by_split(judged).items()},
        "scenes_digest": scenes_digest(),
        "versions": {package: version(package) for package in ("regrasp-gym", "mujoco", "jax", "numpy")},
        "machine": machine(),
        "scenes": by_split(scenes),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".tmp")
    temporary.write_text(_compact(content))
    temporary.replace(path)


def _compact(content: Record) -> str:
    """Indented JSON with each list of numbers in one line."""
    lists = content["scenes"]
    text = json.dumps({**content, "scenes": {split: f"@{split}" for split in lists}}, indent=2)
    for split, scenes in lists.items():
        text = text.replace(f'"@{split}"', json.dumps(scenes))
    return text + "\n"


def _prepare(setting: Record) -> Trial:
    # These load JAX, which only the processes that plan need.
    from regrasp_bench.tables.episodes import run_episode

    env = gymnasium.make(setting["env"])
    expert = regrasp_gym.PlannerExpert(env, setting["strategy"])
    return lambda seed: run_episode(env, expert, seed)


def _show(lists: dict[str, list[int]], records: Sequence[Record], folder: Path) -> None:
    console = Console()
    table = Table("list", *SPLITS, "scenes", title=f"{len(records)} scenes judged")
    for name, scenes in lists.items():
        table.add_row(name, *(str(len(seeds)) for seeds in by_split(scenes).values()), str(len(scenes)))
    console.print(table)
    left = len(records) - sum(map(len, lists.values()))
    console.print(f"{left} scenes in neither list: no plan, or its execution failed. Lists in {folder}", soft_wrap=True)
    for error, seeds in crashes(records).items():
        console.print(f"crashed: {error}, seeds {seeds}", style="red", markup=False, highlight=False)


if __name__ == "__main__":
    main()
