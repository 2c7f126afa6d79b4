"""``regrasp-collect``: run the expert on many seeds and keep the successful episodes as a LeRobot dataset."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from regrasp_datasets.quiet import quiet_environment
from regrasp_gym.errors import RegraspGymError
from regrasp_gym.reports.command_line import JsonFile, require_extra, run_command

if TYPE_CHECKING:
    from regrasp_datasets.selection import Selection
    from regrasp_datasets.workspace import Workspace


@dataclass(frozen=True)
class CollectOptions:
    """Collect demonstrations of the planner's expert as a LeRobot v3.0 dataset.

    Seeds SEED, SEED+1, … are tried in turn, and the first EPISODES that succeed make the dataset, whatever the
    number of workers. --resume goes on with an interrupted collection.
    """

    root: Path
    """Folder of the dataset; it must not exist, unless --resume is given."""
    env: str = "regrasp_gym/PandaYCB-v0"
    """Gymnasium id of the environment."""
    episodes: int = 10
    """Episodes in the dataset."""
    seed: int = 0
    """First seed."""
    workers: int = 1
    """Processes that run episodes at the same time."""
    strategy: str = "repeated"
    """The expert's strategy."""
    require_regrasp: int = 0
    """At least so many of the episodes must hold a regrasp."""
    images: bool = True
    """Whether to record the cameras."""
    image_size: int | None = None
    """Edge of the camera images in pixels; the environment's own by default."""
    control_mode: Literal["joint_pos", "ee_delta"] = "joint_pos"
    """Action space."""
    reward_type: Literal["sparse", "dense"] = "sparse"
    """Reward that is recorded."""
    codec: Literal["libsvtav1", "h264"] = "libsvtav1"
    """Video codec."""
    keep_failures: bool = False
    """Also keep executed episodes that failed; next.success tells them apart."""
    resume: bool = False
    """Go on with an interrupted collection, or add episodes to a finished one."""
    max_attempts: int | None = None
    """Most seeds to try; 20 per episode by default."""
    episode_timeout: float = 900.0
    """Seconds after which an episode is given up."""
    expert: str = "regrasp_gym:PlannerExpert"
    """Class of the expert, as module:name; constructed with (env, strategy, seed)."""
    video: Path | None = None
    """MP4 file of one episode (the first with a regrasp), seen by the overview camera."""
    plan_picture: Path | None = None
    """Picture of the plan of that episode."""
    json_file: JsonFile = None
    """Write everything that is printed as JSON."""


class CollectError(RegraspGymError):
    """Options contradict each other, or a collection cannot go on."""


def main() -> int:
    """Entry point of ``regrasp-collect``; exit code 1 if the dataset is incomplete."""
    options = tyro.cli(CollectOptions, prog="regrasp-collect", description=CollectOptions.__doc__)
    quiet_environment()
    return run_command("regrasp-collect", lambda: collect(options), resume="go on with --resume")


def collect(options: CollectOptions, console: Console | None = None) -> int:
    """Collect a dataset and report.

    Returns:
        0 if the dataset is complete, 1 if too few seeds succeeded, 130 after Ctrl-C.

    Raises:
        CollectError: the options contradict each other, or every attempt crashes.
        WorkspaceError: the output folder cannot be used.
        WorkerError: the environment or the expert cannot be set up.
    """
    require_extra("regrasp-collect", "lerobot")
    from regrasp_datasets.collect_report import make_pictures, report
    from regrasp_datasets.workspace import Workspace

    console = console or Console()
    _check(options)
    started = time.perf_counter()
    settings = settings_of(options)
    with Workspace(options.root, settings, resume=options.resume) as workspace:
        interrupted = False
        failure: Exception | None = None
        try:
            with _sigterm_as_interrupt():
                _run(options, workspace, console)
        except KeyboardInterrupt:
            interrupted = True
            console.print(
                "[yellow]Interrupted.[/] Saving the finished episodes; a second Ctrl-C leaves that to --resume."
            )
        except Exception as error:
            failure = error
        chosen = _select(options, workspace)
        if chosen.seeds:
            with console.status("Merging the episodes"):
                workspace.publish(chosen.seeds, chosen.attempts)
        if failure is not None:
            raise failure
        pictured: dict[str, Any] = {}
        if chosen.complete:
            pictured = make_pictures(options, workspace.plans, console)
            workspace.finish()
        seconds = time.perf_counter() - started
        report(options, settings, chosen.attempts, seconds, pictured, console)
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
    """Options that decide the content of an episode. A resumed collection must have the same."""
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
        raise CollectError("--episodes and --workers must be at least 1.")
    if not 0 <= options.require_regrasp <= options.episodes:
        raise CollectError(f"--require-regrasp must be between 0 and --episodes ({options.episodes}).")
    if options.seed < 0:
        raise CollectError("--seed must be 0 or more.")
    if options.image_size is not None and not 64 <= options.image_size <= 1024:
        raise CollectError("--image-size must be between 64 and 1024 pixels.")


def _select(options: CollectOptions, workspace: Workspace) -> Selection:
    from regrasp_datasets.selection import select

    return select(
        workspace.attempts,
        first=options.seed,
        episodes=options.episodes,
        regrasps=options.require_regrasp,
        published=workspace.published,
    )


def _run(options: CollectOptions, workspace: Workspace, console: Console) -> None:
    from regrasp_datasets.collect_report import attempt_line
    from regrasp_datasets.rollout import RolloutOptions
    from regrasp_datasets.workers import WorkerOptions, WorkerPool

    worker_options = WorkerOptions(
        rollout=RolloutOptions(options.env, env_kwargs_of(options), options.expert, options.strategy),
        shards=workspace.shards,
        logs=workspace.logs,
        plans=workspace.plans if options.plan_picture is not None else None,
        codec=options.codec,
        keep_failures=options.keep_failures,
        timeout=options.episode_timeout,
    )

    last_seed = options.seed + (options.max_attempts or 20 * options.episodes) - 1
    chosen = _select(options, workspace)
    if chosen.complete:
        return
    retried: set[int] = set()
    crashes = 0
    console.print(
        f"Starting {options.workers} worker(s). The first plans compile the planner for minutes, once per machine."
    )
    with WorkerPool(worker_options, options.workers) as pool, _progress(console) as progress:
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
                progress.console.print(attempt_line(attempt), soft_wrap=True, highlight=False)
                crashes = crashes + 1 if attempt.outcome == "crashed" else 0
                if crashes == 3:
                    raise CollectError(
                        f"Three attempts in a row crashed, the last: {attempt.reason} ({workspace.logs})"
                    )
            chosen = _select(options, workspace)
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


if __name__ == "__main__":
    sys.exit(main())
