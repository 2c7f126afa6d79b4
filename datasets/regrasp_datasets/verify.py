"""Check a dataset: frames, videos, seeds and records agree, and every number is finite."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from regrasp_datasets.features import (
    ACTION,
    DONE,
    ENVIRONMENT_STATE,
    REWARD,
    SEED,
    STAGE_INDEX,
    STATE,
    SUCCESS,
    TRUNCATED,
)
from regrasp_datasets.records import DatasetError, EpisodeRecord, read_episodes

REQUIRED_FEATURES = {
    STATE: "float32",
    ENVIRONMENT_STATE: "float32",
    ACTION: "float32",
    REWARD: "float32",
    SUCCESS: "bool",
    DONE: "bool",
    TRUNCATED: "bool",
    STAGE_INDEX: "int64",
    SEED: "int64",
}
"""Features of every dataset besides cameras, with their dtypes."""

TIME_TOLERANCE = 1e-4
"""Largest error of a time stamp, seconds; LeRobot's own default."""


class InvalidDatasetError(DatasetError):
    """A damaged dataset. The message lists the problems."""


def require_valid(root: Path) -> None:
    """Check that `problems` finds none.

    Raises:
        InvalidDatasetError: it finds some.
        DatasetError: there is no dataset at ``root``.
    """
    found = problems(root)
    if found:
        raise InvalidDatasetError(f"{root} is damaged:\n  " + "\n  ".join(found))


def problems(root: Path) -> list[str]:
    """Problems of the dataset at ``root``, one line each.

    Video frames are counted in the files: a writer that drops frames leaves metadata that looks right.

    Raises:
        DatasetError: there is no dataset at ``root``.
    """
    records = read_episodes(root)
    info = json.loads((root / "meta/info.json").read_text())
    episodes = _read_parquet(root / "meta/episodes")
    episodes = episodes.sort_values("episode_index").reset_index(drop=True)

    found = _feature_problems(info)
    found += _record_problems(records, info, episodes)
    if found:
        return found
    frames = _read_parquet(root / "data", columns=[*REQUIRED_FEATURES, "episode_index", "frame_index", "timestamp"])
    if len(frames) != info["total_frames"]:
        return [f"{len(frames)} frames in data/, {info['total_frames']} in meta/info.json"]
    frames = frames.sort_values(["episode_index", "frame_index"])
    for index, episode in frames.groupby("episode_index"):
        found += [f"episode {index}: {problem}" for problem in _episode_problems(episode, records[int(index)], info)]  # type: ignore[call-overload]
    for key, feature in info["features"].items():
        if feature["dtype"] == "video":
            found += [f"{key}: {problem}" for problem in _video_problems(root, key, info, episodes)]
    return found


def _feature_problems(info: dict[str, Any]) -> list[str]:
    features = info["features"]
    found = [f"feature {key} is missing" for key in REQUIRED_FEATURES if key not in features]
    found += [
        f"feature {key} is {features[key]['dtype']}, not {dtype}"
        for key, dtype in REQUIRED_FEATURES.items()
        if key in features and features[key]["dtype"] != dtype
    ]
    return found


def _record_problems(records: list[EpisodeRecord], info: dict[str, Any], episodes: Any) -> list[str]:
    found: list[str] = []
    if not len(records) == info["total_episodes"] == len(episodes):
        return [
            f"{len(records)} episode records, {info['total_episodes']} episodes in meta/info.json and {len(episodes)} "
            "in meta/episodes"
        ]
    if [record.episode_index for record in records] != list(range(len(records))):
        found.append("episode records are not in the order of their index")
    seeds = [record.seed for record in records]
    repeated = sorted({seed for seed in seeds if seeds.count(seed) > 1}) if len(set(seeds)) < len(seeds) else []
    if repeated:
        found.append(f"seeds {repeated} occur more than once")
    lengths = [int(length) for length in episodes["length"]]
    if [record.frames for record in records] != lengths:
        found.append("episode records and meta/episodes disagree about the number of frames")
    return found


def _episode_problems(episode: Any, record: EpisodeRecord, info: dict[str, Any]) -> list[str]:
    found: list[str] = []
    count = len(episode)
    if count != record.frames:
        return [f"{count} frames, {record.frames} in its record"]
    if not np.array_equal(episode["frame_index"].to_numpy(), np.arange(count)):
        found.append("frame indices are not 0, 1, 2, …")
    if np.abs(episode["timestamp"].to_numpy() - np.arange(count) / info["fps"]).max() > TIME_TOLERANCE:
        found.append("time stamps are not frame_index / fps")
    if (episode[SEED].to_numpy() != record.seed).any():
        found.append(f"frames carry other seeds than {record.seed}")
    done = episode[DONE].to_numpy()
    if done[:-1].any() or not done[-1]:
        found.append("next.done is not true on the last frame only")
    if bool(episode[SUCCESS].to_numpy()[-1]) != record.success:
        found.append("next.success of the last frame and the record disagree")
    for key in (STATE, ENVIRONMENT_STATE, ACTION, REWARD):
        values = np.stack(episode[key].to_numpy()) if key != REWARD else episode[key].to_numpy()
        if not np.isfinite(values).all():
            found.append(f"{key} is not finite in frame {int(np.argwhere(~np.isfinite(values))[0][0])}")
        shape = tuple(info["features"][key]["shape"])
        if key != REWARD and values.shape[1:] != shape:
            found.append(f"{key} has shape {values.shape[1:]}, not {shape}")
    return found


def _video_problems(root: Path, key: str, info: dict[str, Any], episodes: Any) -> list[str]:
    found: list[str] = []
    prefix = f"videos/{key}/"
    for (chunk, file), group in episodes.groupby([prefix + "chunk_index", prefix + "file_index"]):
        path = root / info["video_path"].format(video_key=key, chunk_index=int(chunk), file_index=int(file))
        if not path.exists():
            found.append(f"{path.relative_to(root)} is missing")
            continue
        expected, present = int(group["length"].sum()), video_frames(path)
        if expected != present:
            found.append(f"{path.relative_to(root)} has {present} frames, its episodes have {expected}")
        starts = group[prefix + "from_timestamp"].to_numpy()
        lengths = group["length"].to_numpy()
        if np.abs(starts - (np.cumsum(lengths) - lengths) / info["fps"]).max() > TIME_TOLERANCE:
            found.append(f"{path.relative_to(root)}: an episode does not start where the one before it ends")
    return found


def video_frames(path: Path) -> int:
    """Number of frames in a video file, counted packet by packet."""
    import av

    count = 0
    with av.open(str(path)) as container:
        for packet in container.demux(video=0):
            count += packet.size > 0
    return count


def _read_parquet(folder: Path, columns: list[str] | None = None) -> Any:
    import pandas

    files = sorted(folder.rglob("*.parquet"))
    if not files:
        raise DatasetError(f"{folder} holds no data.")
    try:
        return pandas.concat([pandas.read_parquet(file, columns=columns) for file in files], ignore_index=True)
    except (OSError, ValueError) as error:
        raise DatasetError(f"{folder} cannot be read: {error}") from error
