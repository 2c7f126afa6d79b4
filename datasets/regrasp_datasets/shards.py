"""Episodes on disk: each is a small dataset of its own; these are merged into one at the end.

LeRobot's writer loses whatever is not finalised. So each episode is written, finalised, checked and then renamed.
Whatever kills the process, every saved episode is whole and readable.
"""

from __future__ import annotations

import os
import shutil
import uuid
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from regrasp_datasets.features import frame_of
from regrasp_datasets.quiet import quiet_lerobot
from regrasp_datasets.records import EPISODES_FILE, EpisodeRecord, read_episodes, repo_id_of
from regrasp_datasets.rollout import Rollout
from regrasp_datasets.verify import require_valid
from regrasp_gym.reports.files import rewrite_lines

MERGE_FAN_IN = 24
"""Most datasets merged at once. Each merge rewrites all earlier ones, so many are merged as a tree."""


def shard_path(folder: Path, seed: int) -> Path:
    """Folder of the episode of ``seed``."""
    return folder / f"seed-{seed:08d}"


def shard_seeds(folder: Path) -> list[int]:
    """Seeds of the finished episodes in ``folder``, ascending."""
    return sorted(int(path.name.removeprefix("seed-")) for path in folder.glob("seed-*"))


def write_shard(
    folder: Path,
    rollout: Rollout,
    record: EpisodeRecord,
    *,
    features: dict[str, dict[str, Any]],
    fps: int,
    robot_type: str | None,
    codec: str,
) -> Path:
    """Write one episode as a dataset under ``folder``, whole or not at all.

    Args:
        folder: folder of all episodes.
        rollout: the episode.
        record: its record.
        features: from `regrasp_datasets.features.features_of`.
        fps: control frequency, Hz.
        robot_type: the robot's name for LeRobot.
        codec: video codec, by LeRobot's name.

    Returns:
        The folder of the episode.

    Raises:
        InvalidDatasetError: the written episode is damaged.
    """
    from lerobot.configs import RGBEncoderConfig
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    quiet_lerobot()
    temporary = folder / f".unfinished-{record.seed:08d}-{uuid.uuid4().hex[:8]}"
    has_images = any(feature["dtype"] == "video" for feature in features.values())
    try:
        dataset = LeRobotDataset.create(
            repo_id=repo_id_of(folder),
            fps=fps,
            features=features,
            root=temporary,
            robot_type=robot_type,
            use_videos=has_images,
            video_backend="pyav",
            rgb_encoder=RGBEncoderConfig(vcodec=codec) if has_images else None,
            encoder_threads=1,
            image_writer_threads=2 if has_images else 0,
        )
        last = len(rollout.steps) - 1
        for index, step in enumerate(rollout.steps):
            dataset.add_frame(frame_of(step, seed=record.seed, done=index == last, task=rollout.task))
        dataset.save_episode(parallel_encoding=False)
        dataset.finalize()
        rewrite_lines(temporary / EPISODES_FILE, [record])
        shutil.rmtree(temporary / "images", ignore_errors=True)
        require_valid(temporary)
        final = shard_path(folder, record.seed)
        os.rename(temporary, final)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return final


def remove_unfinished(folder: Path) -> None:
    """Remove episodes that a killed process left half-written."""
    for path in folder.glob(".unfinished-*"):
        shutil.rmtree(path, ignore_errors=True)


def merge(sources: Sequence[Path], destination: Path) -> None:
    """Merge datasets and their records, in the given order.

    Args:
        sources: finished datasets with the same features.
        destination: folder of the result; it must not exist.

    Raises:
        ValueError: ``sources`` is empty.
        InvalidDatasetError: the merged dataset is damaged.
    """
    if not sources:
        raise ValueError("There are no episodes to merge.")
    quiet_lerobot()
    records = [record for source in sources for record in read_episodes(source)]
    _merge_frames(list(sources), destination)
    rewrite_lines(
        destination / EPISODES_FILE, [replace(record, episode_index=index) for index, record in enumerate(records)]
    )
    require_valid(destination)


def _merge_frames(sources: list[Path], destination: Path) -> None:
    from lerobot.datasets.aggregate import aggregate_datasets

    partial: list[Path] = []
    if len(sources) > MERGE_FAN_IN:
        for start in range(0, len(sources), MERGE_FAN_IN):
            part = destination.with_name(f"{destination.name}-part-{start:06d}")
            shutil.rmtree(part, ignore_errors=True)
            _merge_frames(sources[start : start + MERGE_FAN_IN], part)
            partial.append(part)
        _merge_frames(partial, destination)
    else:
        aggregate_datasets(
            repo_ids=[repo_id_of(source) for source in sources],
            aggr_repo_id=repo_id_of(destination),
            roots=sources,
            aggr_root=destination,
        )
    for part in partial:
        shutil.rmtree(part)
