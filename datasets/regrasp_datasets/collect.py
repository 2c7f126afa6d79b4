"""``regrasp-collect``: let the expert act on many seeds and keep what succeeds as a LeRobot dataset."""

from __future__ import annotations

import signal
import sys
import time
from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from regrasp_datasets.quiet import quiet_environment
from regrasp_gym.errors import RegraspGymError
from regrasp_gym.reports.command_line import JsonFile, require_extra, run_command
from regrasp_gym.reports.files import write_json


@dataclass(frozen=True)
class CollectOptions:
    """Collect demonstrations of the planner's expert as a LeRobot v3.0 dataset.

    Seeds SEED, SEED+1, … are tried in turn, and the first EPISODES that succeed make the dataset, however many workers
    there are. An interrupted collection goes on with --resume.
    """

    root: Path
    """Folder of the dataset; it must not exist, unless --resume is given."""
    env: str = "regrasp_gym/PandaYCB-v0"
    """Gymnasium id of the environment."""
    episodes: int = 10
    """How many episodes the dataset is to hold."""
    seed: int = 0
    """First seed."""
    workers: int = 1
    """Processes that run episodes at the same time."""
    strategy: str = "repeated"
    """The expert's strategy."""
    require_regrasp: int = 0
    """How many of the episodes at least must hold a regrasp."""
    images: bool = True
    """Whether to record the cameras."""
    image_size: int | None = None
    """Edge of the camera images in pixels; the environment's own by default."""
    control_mode: Literal["joint_pos", "ee_delta"] = "joint_pos"
    """What an action means."""
    reward_type: Literal["sparse", "dense"] = "sparse"
    """Which reward is recorded."""
    codec: Literal["libsvtav1", "h264"] = "libsvtav1"
    """Video codec."""
    keep_failures: bool = False
    """Keep executed episodes that failed, too; next.success tells them apart."""
    resume: bool = False
    """Go on with an interrupted collection, or add episodes to a finished one."""
    max_attempts: int | None = None
    """How many seeds are tried at most; 20 per episode by default."""
    episode_timeout: float = 900.0
    """Seconds after which an episode is given up."""
    expert: str = "regrasp_gym:PlannerExpert"
    """Class that acts, as module:name; it is made with (env, strategy, seed)."""
    video: Path | None = None
    """MP4 file for one of the episodes (the first with a regrasp), seen by the overview camera."""
    plan_picture: Path | None = None
    """Picture of the plan of that episode."""
    json_file: JsonFile = None
    """File for everything that is printed, as JSON."""


class CollectError(RegraspGymError):
    """Options that contradict each other, or a collection that cannot go on. The message says what to do."""


def main() -> int:
    """Entry point of ``regrasp-collect``: 0 if the dataset is complete, 1 if not, 2 for wrong use, 130 for Ctrl-C."""
    options = tyro.cli(CollectOptions, prog="regrasp-collect", description=CollectOptions.__doc__)
    quiet_environment()
    return run_command("regrasp-collect", lambda: collect(options), resume="go on with --resume")


def collect(options: CollectOptions, console: Console | None = None) -> int:
    """Do what ``options`` say.

    Returns:
        0 if the dataset holds what was asked for, 1 if too few seeds succeeded, 130 after Ctrl-C.

    Raises:
        CollectError: the options contradict each other, or every attempt crashes.
        WorkspaceError: the output folder cannot be used.
        WorkerError: the environment or the expert cannot be set up.
    """
    from regrasp_datasets.selection import select
    from regrasp_datasets.workspace import Workspace

    require_extra("regrasp-collect", "lerobot")
    console = console or Console()
    _check(options)
    started = time.perf_counter()
    with Workspace(options.root, settings_of(options), resume=options.resume) as workspace:
        interrupted = False
        failure: Exception | None = None
        try:
            with _sigterm_as_interrupt():
                _run(options, workspace, console)
        except KeyboardInterrupt:
            interrupted = True
            console.print("[yellow]Interrupted.[/] Saving what there is; Ctrl-C once more leaves it for --resume.")
        except Exception as error:
            failure = error
        chosen = select(
            workspace.attempts,
            first=options.seed,
            episodes=options.episodes,
            regrasps=options.require_regrasp,
            published=workspace.published,
        )
        if chosen.seeds:
            with console.status("Merging the episodes"):
                workspace.publish(chosen.seeds, chosen.attempts)
        if failure is not None:
            raise failure
        pictured: dict[str, Any] = {}
        if chosen.complete:
            pictured = _pictures(options, workspace.plans, console)
            workspace.finish()
        seconds = time.perf_counter() - started
        _report(options, chosen.attempts, seconds, pictured, console)
        if interrupted:
            console.print(f"Go on with --resume; unfinished work lies in {workspace.folder}.", soft_wrap=True)
            return 130
        if not chosen.complete:
            console.print(
                f"[red]Only {len(chosen.seeds)} of {options.episodes} episodes[/] after "
                f"{len(chosen.attempts)} seeds. Raise --max-attempts and add --resume to go on."
            )
            return 1
        return 0


def settings_of(options: CollectOptions) -> dict[str, Any]:
    """The options that decide what an episode holds; a resumed collection must have the same."""
    return {
        "env": options.env,
        "env_kwargs": env_kwargs_of(options),
        "seed": options.seed,
        "strategy": options.strategy,
        "expert": options.expert,
        "codec": options.codec,
        "keep_failures": options.keep_failures,
    }


def env_kwargs_of(options: CollectOptions) -> dict[str, Any]:
    """Keyword arguments for ``gym.make``."""
    from regrasp_datasets.features import IMAGES_OBS_TYPE, VECTORS_OBS_TYPE

    kwargs: dict[str, Any] = {
        "obs_type": IMAGES_OBS_TYPE if options.images else VECTORS_OBS_TYPE,
        "control_mode": options.control_mode,
        "reward_type": options.reward_type,
    }
    if options.images and options.image_size is not None:
        kwargs["image_size"] = [options.image_size, options.image_size]
    return kwargs


def _check(options: CollectOptions) -> None:
    if options.episodes < 1 or options.workers < 1:
        raise CollectError("--episodes and --workers have to be at least 1.")
    if not 0 <= options.require_regrasp <= options.episodes:
        raise CollectError(f"--require-regrasp has to be between 0 and --episodes ({options.episodes}).")
    if options.seed < 0:
        raise CollectError("--seed has to be 0 or more.")
    if options.image_size is not None and not 64 <= options.image_size <= 1024:
        raise CollectError("--image-size has to be between 64 and 1024 pixels.")


def _run(options: CollectOptions, workspace: Any, console: Console) -> None:
    from regrasp_datasets.rollout import RolloutOptions
    from regrasp_datasets.selection import select
    from regrasp_datasets.workers import WorkerOptions, WorkerPool

    config = WorkerOptions(
        rollout=RolloutOptions(options.env, env_kwargs_of(options), options.expert, options.strategy),
        shards=workspace.shards,
        logs=workspace.logs,
        plans=workspace.plans if options.plan_picture is not None else None,
        codec=options.codec,
        keep_failures=options.keep_failures,
        timeout=options.episode_timeout,
    )

    def current() -> Any:
        return select(
            workspace.attempts,
            first=options.seed,
            episodes=options.episodes,
            regrasps=options.require_regrasp,
            published=workspace.published,
        )

    last_seed = options.seed + (options.max_attempts or 20 * options.episodes) - 1
    chosen = current()
    if chosen.complete:
        return
    retried: set[int] = set()
    crashes = 0
    console.print(
        f"Starting {options.workers} worker(s). The first plans compile the planner for minutes, once per machine."
    )
    with WorkerPool(config, options.workers) as pool, _progress(console) as progress:
        bar = progress.add_task(
            "episodes", total=options.episodes, completed=len(chosen.seeds), note="starting workers"
        )
        seed = options.seed
        again: list[int] = []
        while not chosen.complete:
            while pool.idle and (again or seed <= last_seed):
                if again:
                    pool.assign(again.pop(), need_regrasp=chosen.need_regrasp)
                    continue
                if seed not in workspace.attempts and seed not in pool.busy_seeds:
                    pool.assign(seed, need_regrasp=chosen.need_regrasp)
                seed += 1
            if not pool.busy_seeds and not again and seed > last_seed:
                return
            for attempt in pool.results(timeout=1.0):
                if attempt.outcome == "crashed" and attempt.seed not in retried:
                    retried.add(attempt.seed)
                    again.append(attempt.seed)
                    continue
                workspace.add(attempt)
                progress.console.print(_line(attempt), soft_wrap=True, highlight=False)
                crashes = crashes + 1 if attempt.outcome == "crashed" else 0
                if crashes == 3:
                    raise CollectError(f"Three attempts in a row crashed, the last: {attempt.reason} ({config.logs})")
            chosen = current()
            tried = len(workspace.attempts)
            progress.update(bar, completed=len(chosen.seeds), note=f"{tried} seeds tried")


@contextmanager
def _sigterm_as_interrupt() -> Generator[None]:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("[bold]{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[note]}"),
        console=console,
    )


def _line(attempt: Any) -> str:
    words = f"seed {attempt.seed:>5}  {attempt.target:<26} {attempt.outcome}"
    if attempt.stages:
        words += f", {attempt.stages} stage{'s' if attempt.stages > 1 else ''}"
    words += f", planned in {attempt.planning_seconds:.1f} s"
    return words + (f" ({attempt.cause})" if attempt.cause else "")


def _pictures(options: CollectOptions, plans: Path, console: Console) -> dict[str, Any]:
    """Film and draw one episode: the first with a regrasp if there is one."""
    if options.video is None and options.plan_picture is None:
        return {}
    from regrasp_datasets.records import read_episodes
    from regrasp_datasets.replay import film_episode, picture_plan
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


def _report(
    options: CollectOptions, attempts: list[Any], seconds: float, pictured: dict[str, Any], console: Console
) -> None:
    from regrasp_datasets.records import read_episodes, versions

    records = read_episodes(options.root) if options.root.exists() else []
    table = Table("#", "seed", "object", "strategy", "stages", "planning s", "frames", "success", box=None)
    for record in records:
        table.add_row(
            str(record.episode_index),
            str(record.seed),
            record.target,
            record.strategy,
            str(record.stages),
            f"{record.planning_seconds:.2f}",
            str(record.frames),
            "yes" if record.success else "no",
        )
    console.print(table)
    causes = Counter(
        f"{attempt.outcome}: {attempt.cause}" if attempt.cause else attempt.outcome
        for attempt in attempts
        if attempt.outcome != "success"
    )
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
            "settings": settings_of(options),
            "episodes": [asdict(record) for record in records],
            "attempts": [asdict(attempt) for attempt in attempts],
            "failures": dict(causes),
            "frames": frames,
            "regrasps": regrasps,
            "seconds": seconds,
            "pictured": pictured,
            "versions": versions(),
        }
        write_json(options.json_file, summary)


if __name__ == "__main__":
    sys.exit(main())
