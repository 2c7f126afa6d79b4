"""``regrasp-replay``: run a dataset's actions again and check that every episode ends as recorded."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import gymnasium as gym
import numpy as np
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

from regrasp_datasets.features import (
    ENVIRONMENT_STATE,
    REWARD,
    STATE,
    SUCCESS,
    observe,
)
from regrasp_datasets.films import EpisodeFrames, EpisodeReader, film_episode, replay_env
from regrasp_datasets.quiet import quiet_environment
from regrasp_datasets.records import DatasetError, EpisodeRecord, read_episodes, versions
from regrasp_datasets.rollout import digest_of
from regrasp_gym.reports.command_line import JsonFile, require_extra, run_command
from regrasp_gym.reports.files import write_json


@dataclass(frozen=True)
class ReplayOptions:
    """Run the actions of a dataset again from the stored seeds, and compare states and success.

    Exits with 1 if an episode's success is not reproduced, or if its states differ by more than the tolerance.
    """

    root: Path
    """Folder of the dataset."""
    episodes: tuple[int, ...] = ()
    """Indices of the episodes; all by default."""
    tolerance: float = 0.0
    """Largest difference of any recorded state, m or rad; 0 demands equality to the last bit. Another machine or
    version of MuJoCo rounds differently."""
    video: Path | None = None
    """MP4 file of the first of these episodes, seen by the overview camera."""
    json_file: JsonFile = None
    """Write the outcome as JSON."""


@dataclass(frozen=True)
class ReplayResult:
    """How a replayed episode compares with the recorded one.

    Attributes:
        episode_index: its index in the dataset.
        seed: its seed.
        target: name of the object.
        frames: steps run.
        recorded_success: success after the last step, as recorded.
        replayed_success: the same, now.
        exact: every recorded number and the double-precision physics state at both ends are equal to the last bit.
        max_state_error: largest difference among observation.state and observation.environment_state.
        first_difference: frame and feature of the first difference, or None.
        seconds: time it took.
    """

    episode_index: int
    seed: int
    target: str
    frames: int
    recorded_success: bool
    replayed_success: bool
    exact: bool
    max_state_error: float
    first_difference: str | None
    seconds: float

    def reproduced(self, tolerance: float) -> bool:
        """Whether success is the same and the states agree within ``tolerance`` (0: to the last bit)."""
        same_states = self.exact or (tolerance > 0 and self.max_state_error <= tolerance)
        return self.recorded_success == self.replayed_success and same_states


def replay_episode(env: gym.Env, record: EpisodeRecord, frames: EpisodeFrames) -> ReplayResult:
    """Reset ``env`` with the episode's seed, run its actions and compare.

    Args:
        env: made by `replay_env`.
        record: record of the episode.
        frames: its numbers.
    """
    started = time.perf_counter()
    obs, _ = env.reset(seed=record.seed)
    difference: str | None = None
    if digest_of(env) != record.initial_state_sha256:
        difference = "physics state after the reset"
    error = 0.0
    success = False
    count = len(frames.action)
    for index in range(count):
        now = observe(env, obs)
        for key, shown, recorded in (
            (STATE, now.state, frames.state),
            (ENVIRONMENT_STATE, now.environment_state, frames.environment_state),
        ):
            if not np.array_equal(shown, recorded[index]):
                difference = difference or f"frame {index}: {key}"
                error = max(error, float(np.abs(shown.astype(np.float64) - recorded[index]).max()))
        obs, reward, terminated, truncated, info = env.step(frames.action[index])
        success = bool(info["is_success"])
        if np.float32(reward) != frames.reward[index]:
            difference = difference or f"frame {index}: {REWARD}"
        if success != frames.success[index]:
            difference = difference or f"frame {index}: {SUCCESS}"
        if (terminated or truncated) and index < count - 1:
            difference = difference or f"frame {index}: the episode ended, {count} frames were recorded"
            break
    if digest_of(env) != record.final_state_sha256:
        difference = difference or "physics state after the last step"
    return ReplayResult(
        episode_index=record.episode_index,
        seed=record.seed,
        target=record.target,
        frames=count,
        recorded_success=record.success,
        replayed_success=success,
        exact=difference is None,
        max_state_error=error,
        first_difference=difference,
        seconds=time.perf_counter() - started,
    )


def main() -> int:
    """Entry point of ``regrasp-replay``; exit code 1 if an episode is not reproduced."""
    options = tyro.cli(ReplayOptions, prog="regrasp-replay", description=ReplayOptions.__doc__)
    quiet_environment()
    return run_command("regrasp-replay", lambda: replay(options))


def replay(options: ReplayOptions, console: Console | None = None) -> int:
    """Replay episodes and report.

    Returns:
        0 if every episode is reproduced, 1 otherwise.

    Raises:
        DatasetError: the folder holds no complete dataset, or it has no such episode.
        RolloutError: the environment cannot be made.
    """
    from regrasp_datasets.verify import require_valid

    require_extra("regrasp-replay", "lerobot")
    console = console or Console()
    require_valid(options.root)
    records = read_episodes(options.root)
    wanted = options.episodes or tuple(range(len(records)))
    for index in wanted:
        if not 0 <= index < len(records):
            raise DatasetError(f"{options.root} has episodes 0 to {len(records) - 1}: there is no episode {index}.")
    reader = EpisodeReader(options.root)
    results: list[ReplayResult] = []
    env: gym.Env | None = None
    made_for: tuple[str, str] | None = None
    for index in track(wanted, "Replaying", console=console, transient=True):
        record = records[index]
        recipe = (record.env_id, json.dumps(record.env_kwargs, sort_keys=True))
        if env is None or made_for != recipe:
            if env is not None:
                env.close()
            env, made_for = replay_env(record), recipe
        results.append(replay_episode(env, record, reader.read(index)))
    if env is not None:
        env.close()
    if options.video is not None:
        film_episode(options.root, records[wanted[0]], options.video)
    return _report(options, results, records, console)


def _report(options: ReplayOptions, results: list[ReplayResult], records: list[EpisodeRecord], console: Console) -> int:
    table = Table("#", "seed", "object", "frames", "success", "replayed", "states", "ms/frame", box=None)
    for result in results:
        table.add_row(
            str(result.episode_index),
            str(result.seed),
            result.target,
            str(result.frames),
            "yes" if result.recorded_success else "no",
            "yes" if result.replayed_success else "no",
            "equal" if result.exact else f"≤ {result.max_state_error:.1e} off",
            f"{1e3 * result.seconds / result.frames:.1f}",
        )
    console.print(table)
    for result in results:
        if result.first_difference is not None:
            console.print(f"episode {result.episode_index}: first difference: {result.first_difference}")
    good = [result for result in results if result.reproduced(options.tolerance)]
    exact = sum(result.exact for result in results)
    console.print(f"{len(good)} of {len(results)} episodes reproduced, {exact} of them to the last bit.")
    now = versions()
    changed = {
        f"{name} {record.versions[name]} (now {now.get(name)})"
        for record in records
        for name in record.versions
        if record.versions[name] != now.get(name)
    }
    if changed and len(good) < len(results):
        console.print(f"[yellow]Recorded with other versions:[/] {', '.join(sorted(changed))}.")
    if options.json_file is not None:
        summary = {
            "root": str(options.root),
            "tolerance": options.tolerance,
            "reproduced": len(good),
            "exact": exact,
            "episodes": [asdict(result) | {"reproduced": result.reproduced(options.tolerance)} for result in results],
            "versions": now,
        }
        write_json(options.json_file, summary)
    return 0 if len(good) == len(results) else 1


if __name__ == "__main__":
    sys.exit(main())
