"""``regrasp-replay``: run a dataset's actions again and check that every episode comes out as it was recorded."""

from __future__ import annotations

import json
import pickle
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from jaxtyping import UInt8
from rich.console import Console
from rich.progress import track
from rich.table import Table

from regrasp_datasets.features import (
    ACTION,
    ENVIRONMENT_STATE,
    REWARD,
    STATE,
    SUCCESS,
    VECTORS_OBS_TYPE,
    base_env,
    observe,
)
from regrasp_datasets.quiet import quiet_environment, quiet_lerobot
from regrasp_datasets.records import DatasetError, EpisodeRecord, read_episodes, require_dataset, versions
from regrasp_datasets.rollout import RolloutError, RolloutOptions, digest_of, make_env, make_expert
from regrasp_gym.rendering.film import write_film
from regrasp_gym.reports.command_line import JsonFile, require_extra, run_command
from regrasp_gym.reports.files import write_json


@dataclass(frozen=True)
class ReplayOptions:
    """Run the actions of a dataset again, from the stored seeds, and compare states and success.

    Exits with 1 if an episode's success is not reproduced, or if its states differ by more than the tolerance.
    """

    root: Path
    """Folder of the dataset."""
    episodes: tuple[int, ...] = ()
    """Indices of the episodes to run; all by default."""
    tolerance: float = 0.0
    """Largest difference of any recorded state, m or rad; 0 asks for equality to the last bit. Another machine or
    another version of MuJoCo rounds differently."""
    video: Path | None = None
    """MP4 file of the first of the episodes, seen by the overview camera."""
    json_file: JsonFile = None
    """File for the outcome as JSON."""


@dataclass(frozen=True)
class EpisodeFrames:
    """The recorded numbers of one episode of T frames.

    Attributes:
        state: (T, n) float32.
        environment_state: (T, m) float32.
        action: (T, a) float32.
        reward: (T,) float32.
        success: (T,) bool.
    """

    state: np.ndarray
    environment_state: np.ndarray
    action: np.ndarray
    reward: np.ndarray
    success: np.ndarray


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


class EpisodeReader:
    """Numbers of the episodes of a dataset, without decoding any video.

    Args:
        root: folder of a finished dataset.

    Raises:
        DatasetError: there is none.
    """

    def __init__(self, root: Path) -> None:
        require_dataset(root)
        quiet_lerobot()
        from lerobot.datasets.lerobot_dataset import LeRobotDataset

        self._dataset = LeRobotDataset(f"regrasp-gym/{root.name}", root=root, video_backend="pyav")
        columns = [STATE, ENVIRONMENT_STATE, ACTION, REWARD, SUCCESS]
        self._frames = self._dataset.hf_dataset.select_columns(columns).with_format("numpy")

    def __len__(self) -> int:
        return self._dataset.num_episodes

    def read(self, episode_index: int) -> EpisodeFrames:
        """The numbers of one episode."""
        episodes = self._dataset.meta.episodes
        assert episodes is not None
        episode = episodes[episode_index]
        rows = self._frames[episode["dataset_from_index"] : episode["dataset_to_index"]]
        return EpisodeFrames(
            state=np.asarray(rows[STATE], dtype=np.float32),
            environment_state=np.asarray(rows[ENVIRONMENT_STATE], dtype=np.float32),
            action=np.asarray(rows[ACTION], dtype=np.float32),
            reward=np.asarray(rows[REWARD], dtype=np.float32),
            success=np.asarray(rows[SUCCESS], dtype=bool),
        )


def replay_env(record: EpisodeRecord, **changes: Any) -> gym.Env:
    """The environment an episode was recorded in, without camera observations: they do not touch the physics.

    Args:
        record: of the episode.
        **changes: other keyword arguments for ``gym.make``.
    """
    return make_env(record.env_id, record.env_kwargs | {"obs_type": VECTORS_OBS_TYPE} | changes)


def replay_episode(env: gym.Env, record: EpisodeRecord, frames: EpisodeFrames) -> ReplayResult:
    """Reset ``env`` with the episode's seed, run its actions and compare.

    Args:
        env: made by `replay_env`.
        record: of the episode.
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
            difference = difference or f"frame {index}: the episode ended, recorded were {count} frames"
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


def film_episode(root: Path, record: EpisodeRecord, path: Path) -> None:
    """Run an episode again and write what the overview camera sees as an MP4 file.

    Args:
        root: folder of the dataset.
        record: of the episode.
        path: file to write; its folder is made.
    """
    frames = EpisodeReader(root).read(record.episode_index)
    env = replay_env(record, render_mode="rgb_array")

    def pictures() -> Iterator[UInt8[np.ndarray, "H W 3"]]:
        env.reset(seed=record.seed)
        yield _picture(env)
        for action in frames.action:
            env.step(action)
            yield _picture(env)

    try:
        write_film(path, pictures(), env.metadata["render_fps"])
    finally:
        env.close()


def picture_plan(record: EpisodeRecord, path: Path, stored: Path) -> None:
    """Draw the plan of an episode.

    Args:
        record: of the episode.
        path: PNG file to write; its folder is made.
        stored: pickle of the plan, written by this very collection. Without it the scene is planned again, which
            takes longer and comes to the same.

    Raises:
        RolloutError: the expert finds no plan now, although it did when the episode was recorded.
    """
    from regrasp_gym.expert.plan_picture import save_plan_picture

    env = replay_env(record, render_mode="rgb_array")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        env.reset(seed=record.seed)
        if stored.exists():
            plan = pickle.loads(stored.read_bytes())
        else:
            config = RolloutOptions(record.env_id, record.env_kwargs, record.expert, record.strategy)
            expert = make_expert(config, env)
            if not expert.reset():
                raise RolloutError(f"No plan for seed {record.seed} any more: {expert.failure}")
            plan = expert.plan
        save_plan_picture(base_env(env), plan, path)
    finally:
        env.close()


def main() -> int:
    """Entry point of ``regrasp-replay``: 0 if everything is reproduced, 1 if not, 2 for wrong use."""
    options = tyro.cli(ReplayOptions, prog="regrasp-replay", description=ReplayOptions.__doc__)
    quiet_environment()
    return run_command("regrasp-replay", lambda: replay(options))


def replay(options: ReplayOptions, console: Console | None = None) -> int:
    """Do what ``options`` say.

    Returns:
        0 if every episode is reproduced, 1 otherwise.

    Raises:
        DatasetError: there is no whole dataset at the given folder, or it has no such episode.
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
            raise DatasetError(f"{options.root} has episodes 0 to {len(records) - 1}, and none of index {index}.")
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


def _picture(env: gym.Env) -> np.ndarray:
    picture = env.render()
    if not isinstance(picture, np.ndarray):
        raise RolloutError(f"render() gave a {type(picture).__name__}, not a picture.")
    return picture


if __name__ == "__main__":
    sys.exit(main())
