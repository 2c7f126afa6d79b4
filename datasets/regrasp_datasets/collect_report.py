"""What ``regrasp-collect`` prints, draws and films."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from regrasp_datasets.records import Attempt, failure_causes, read_episodes, versions
from regrasp_gym.reports.files import write_json

if TYPE_CHECKING:
    from regrasp_datasets.collect import CollectOptions


def attempt_line(attempt: Attempt) -> str:
    """One line for the terminal."""
    words = f"seed {attempt.seed:>5}  {attempt.target:<26} {attempt.outcome}"
    if attempt.stages:
        words += f", {attempt.stages} stage{'s' if attempt.stages > 1 else ''}"
    words += f", planned in {attempt.planning_seconds:.1f} s"
    return words + (f" ({attempt.cause})" if attempt.cause else "")


def make_pictures(options: CollectOptions, plans: Path, console: Console) -> dict[str, Any]:
    """Film and draw one episode, if asked for: the first with a regrasp, else the first.

    Returns:
        The episode and the files, for the report; empty if there are none.
    """
    if options.video is None and options.plan_picture is None:
        return {}
    from regrasp_datasets.films import film_episode, picture_plan
    from regrasp_datasets.workers import plan_path

    records = read_episodes(options.root)
    record = next((record for record in records if record.stages >= 2), records[0])
    made: dict[str, Any] = {"episode": record.episode_index, "seed": record.seed}
    if options.video is not None:
        with console.status("Filming an episode"):
            film_episode(options.root, record, options.video)
        made["video"] = str(options.video)
    if options.plan_picture is not None:
        with console.status("Drawing its plan"):
            picture_plan(record, options.plan_picture, plan_path(plans, record.seed))
        made["plan_picture"] = str(options.plan_picture)
    return made


def report(
    options: CollectOptions,
    settings: dict[str, Any],
    attempts: Sequence[Attempt],
    seconds: float,
    pictured: dict[str, Any],
    console: Console,
) -> None:
    """Print a summary of the dataset and the failed seeds, and write it as JSON if asked for.

    Args:
        options: of the collection.
        settings: those of its workspace.
        attempts: what led to the dataset.
        seconds: time it took.
        pictured: from `make_pictures`.
        console: where to print.
    """
    records = read_episodes(options.root) if options.root.exists() else []
    table = Table("#", "seed", "object", "strategy", "stages", "planning s", "frames", "success", box=None)
    for record in records:
        planning, success = f"{record.planning_seconds:.2f}", "yes" if record.success else "no"
        row = (record.episode_index, record.seed, record.target, record.strategy, record.stages)
        table.add_row(*map(str, row), planning, str(record.frames), success)
    console.print(table)
    causes = failure_causes(attempts)
    for cause, count in causes.most_common():
        console.print(f"{count:>4} × {cause}")
    frames = sum(record.frames for record in records)
    regrasps = sum(record.stages >= 2 for record in records)
    console.print(
        f"{len(records)} episodes ({regrasps} with a regrasp), {frames} frames in {options.root}; "
        f"{len(attempts)} seeds tried; {seconds:.0f} s",
        soft_wrap=True,
    )
    for name in ("video", "plan_picture"):
        if name in pictured:
            console.print(f"{name.replace('_', ' ')} of episode {pictured['episode']}: {pictured[name]}")
    if options.json_file is not None:
        summary = {
            "root": str(options.root),
            "settings": settings,
            "episodes": records,
            "attempts": attempts,
            "failures": dict(causes),
            "frames": frames,
            "regrasps": regrasps,
            "seconds": seconds,
            "pictured": pictured,
            "versions": versions(),
        }
        write_json(options.json_file, summary)
