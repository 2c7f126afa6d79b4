"""``regrasp-certify``: list the scenes in which one grasp suffices, and those that need a regrasp."""

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
from regrasp_bench.options import BenchOptions
from regrasp_gym.errors import SceneError
from regrasp_gym.reports.command_line import run_command
from regrasp_gym.reports.files import read_lines, write_text
from regrasp_gym.reports.report import Record, machine, package_versions, write_report
from regrasp_gym.reports.trials import Trial, crashes, print_crashes, run_trials
from regrasp_gym.scenes.table_shelf_config import TableShelfConfig
from regrasp_gym.seeds import FIRST_SEED, SPLITS, split_of

ENV = "regrasp_gym/PandaYCB-v0"

CRITERIA = {
    "panda_ycb_direct": "the planner finds a way with one grasp, and executing it succeeds",
    "panda_ycb_regrasp": "the planner finds no way with one grasp but one with regrasps, and executing it succeeds",
}
"""What is listed, by name of the list."""


@dataclass(frozen=True, kw_only=True)
class CertifyOptions(BenchOptions):
    """Sort the scenes of regrasp_gym/PandaYCB-v0 by difficulty, and write the lists that its variants draw from.

    Each scene is planned with the strategy "repeated", which tries a single grasp first, and the plan is executed in
    the simulation. An interrupted run resumes, and more scenes can be added later: the lists hold all scenes of the
    records that this version judged with this effort.
    """

    train: int = 300
    """Number of scenes judged for training, from seed 0 on."""
    val: int = 75
    """Number of scenes for validation, from seed 500,000,000 on."""
    test: int = 150
    """Number of scenes for the test, from seed 1,000,000,000 on."""
    records: Path = Path("outputs/certify.jsonl")
    """One JSON line per scene, appended as it ends."""
    folder: Path = Path(regrasp_gym.__file__).parent / "seeds"
    """Folder of the lists; by default that of the package."""


def main() -> None:
    """Entry point: exits with 0 if done, 1 if scenes crashed, 2 for wrong use, 130 for Ctrl-C."""
    options = tyro.cli(CertifyOptions, prog="regrasp-certify")
    sys.exit(run_command("regrasp-certify", lambda: certify(options), resume="the same command resumes"))


def certify(options: CertifyOptions) -> int:
    """Judge the scenes and write the lists.

    Returns:
        The exit code: 1 if scenes crashed, else 0.

    Raises:
        SceneError: a list would lack scenes of a split. No list is written then.
    """
    setting = setting_of()
    counts = {"train": options.train, "val": options.val, "test": options.test}
    seeds = [FIRST_SEED[split] + k for split in SPLITS for k in range(counts[split])]
    requested = run_trials(
        setting, seeds, _prepare, workers=options.workers, records=options.records, label="certifying"
    )
    judged = {r["trial"]: r for r in read_lines(options.records) if r.get("setting") == setting}
    records = [judged[trial] for trial in sorted(judged)]
    lists = {name: [record["trial"] for record in records if kind_of(record) == name] for name in CRITERIA}
    for name, scenes in lists.items():
        empty = [split for split, seeds in by_split(scenes).items() if not seeds]
        if empty:
            raise SceneError(f"no scene for {name} in the split {empty[0]!r}: judge more with --{empty[0]}")
    for name, scenes in lists.items():
        write_list(options.folder / f"{name}.json", name, scenes, list(judged))
    _show(lists, records, options.folder)
    counted = {name: {split: len(seeds) for split, seeds in by_split(lists[name]).items()} for name in CRITERIA}
    write_report(options.json_file, {**setting, "judged": len(records), "listed": counted, "crashed": crashes(records)})
    return 1 if crashes(requested) else 0


def setting_of() -> Record:
    """What verdicts depend on: the scenes, the planner's effort and the version."""
    # Loads JAX.
    from regrasp_planner import PlanOptions

    effort = hashlib.sha256(repr(PlanOptions()).encode()).hexdigest()[:16]
    versions = {"version": version("regrasp-gym"), "effort": effort}
    return {"env": ENV, "strategy": "repeated", "scenes": scenes_digest(), **versions}


def by_split(scenes: Sequence[int]) -> dict[str, list[int]]:
    """Scene seeds in order, by split."""
    return {split: [seed for seed in sorted(scenes) if split_of(seed) == split] for split in SPLITS}


def scenes_digest() -> str:
    """Digest of the default scenes' configuration. A list is valid for these scenes only."""
    return hashlib.sha256(repr(TableShelfConfig()).encode()).hexdigest()[:16]


def kind_of(record: Record) -> str | None:
    """Name of the list that a judged scene belongs to, if any."""
    if "crashed" in record or not record["planned"] or not record["success"]:
        return None
    if len(record["stages"]) > 1:
        return "panda_ycb_regrasp"
    # With a second plan, the one grasp did not hold.
    return "panda_ycb_direct" if record["plans"] == 1 else None


def write_list(path: Path, name: str, scenes: Sequence[int], judged: Sequence[int]) -> None:
    """Write a list of scenes by split, whole or not at all."""
    content = {
        "env": ENV,
        "criterion": CRITERIA[name],
        "judged": {split: len(seeds) for split, seeds in by_split(judged).items()},
        "scenes_digest": scenes_digest(),
        "versions": package_versions(("regrasp-gym", "mujoco", "jax", "numpy")),
        "machine": machine(),
        "scenes": by_split(scenes),
    }
    write_text(path, _compact(content))


def _compact(content: Record) -> str:
    """Indented JSON with each list of numbers on one line."""
    lists = content["scenes"]
    text = json.dumps({**content, "scenes": {split: f"@{split}" for split in lists}}, indent=2)
    for split, scenes in lists.items():
        text = text.replace(f'"@{split}"', json.dumps(scenes))
    return text + "\n"


def _prepare(setting: Record) -> Trial:
    # Loads JAX, which only planning processes need.
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
    print_crashes(crashes(records))


if __name__ == "__main__":
    main()
