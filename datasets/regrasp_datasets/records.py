"""What is recorded of an episode besides its frames, so that it can be replayed exactly.

A dataset's ``meta`` folder holds two more files of JSON lines than LeRobot's own: ``regrasp_episodes.jsonl`` with one
line per episode, and ``regrasp_attempts.jsonl`` with one line per tried seed and, if it failed, why.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import platform
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from regrasp_gym.errors import RegraspGymError
from regrasp_gym.reports.files import read_lines

EPISODES_FILE = "meta/regrasp_episodes.jsonl"
ATTEMPTS_FILE = "meta/regrasp_attempts.jsonl"

RECORDED_PACKAGES = ("regrasp-gym", "mujoco", "gymnasium", "numpy", "jax", "jaxlib", "lerobot")

OUTCOMES = ("success", "plan failed", "execution failed", "not needed", "timeout", "crashed")
"""Outcomes of a seed; ``not needed``: one grasp sufficed, and no more such episodes were wanted."""


class DatasetError(RegraspGymError):
    """A folder is not a readable dataset of this project."""


@dataclass(frozen=True)
class EpisodeRecord:
    """What is needed to replay an episode and compare the outcome.

    Attributes:
        episode_index: its index in the dataset.
        seed: seed of the reset.
        env_id: Gymnasium id.
        env_kwargs: keyword arguments of ``gym.make``.
        expert: ``module:name`` of the expert.
        strategy: the expert's strategy.
        target: name of the object that is moved.
        task: the task in words.
        planned_stages: stages of the first plan.
        stages: stages that were executed.
        frames: number of steps.
        success: whether the task is solved after the last step.
        planning_seconds: time in the expert, summed over the episode.
        seconds: time the episode took, writing included.
        initial_state_sha256: digest of the physics state after the reset, double precision.
        final_state_sha256: digest of the physics state after the last step.
        versions: package and interpreter versions, and the machine's architecture.
    """

    episode_index: int
    seed: int
    env_id: str
    env_kwargs: dict[str, Any]
    expert: str
    strategy: str
    target: str
    task: str
    planned_stages: int
    stages: int
    frames: int
    success: bool
    planning_seconds: float
    seconds: float
    initial_state_sha256: str
    final_state_sha256: str
    versions: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Attempt:
    """The outcome of one seed.

    Attributes:
        seed: the seed.
        outcome: one of `OUTCOMES`.
        saved: whether the episode was written.
        cause: why it failed in a few words, the same words for the same cause; empty for a success.
        reason: the cause in full.
        target: name of the object; empty if the episode failed before it was known.
        stages: stages executed, or planned if nothing was executed.
        planning_seconds: time in the expert.
        frames: steps executed.
    """

    seed: int
    outcome: str
    saved: bool = False
    cause: str = ""
    reason: str = ""
    target: str = ""
    stages: int = 0
    planning_seconds: float = 0.0
    frames: int = 0


def failure_causes(attempts: Iterable[Attempt]) -> Counter[str]:
    """How many seeds failed, by outcome and cause."""
    return Counter(
        f"{attempt.outcome}: {attempt.cause}" if attempt.cause else attempt.outcome
        for attempt in attempts
        if attempt.outcome != "success"
    )


def versions() -> dict[str, str]:
    """Versions that an exact replay depends on."""
    found = {name: importlib.metadata.version(name) for name in RECORDED_PACKAGES}
    return found | {"python": platform.python_version(), "machine": f"{platform.system()} {platform.machine()}"}


def state_sha256(*arrays: np.ndarray) -> str:
    """Digest of a physics state, to the last bit.

    Args:
        *arrays: arrays of numbers.

    Returns:
        64 hexadecimal digits.
    """
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(array.dtype.str.encode() + repr(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def repo_id_of(root: Path) -> str:
    """LeRobot's id of the dataset at ``root``; never looked up on the network."""
    return f"regrasp-gym/{root.name}"


def read_episodes(root: Path) -> list[EpisodeRecord]:
    """Records of the episodes of the dataset at ``root``, in the order of their index.

    Raises:
        DatasetError: there is no dataset of this project at ``root``.
    """
    require_dataset(root)
    return [EpisodeRecord(**line) for line in _lines(root / EPISODES_FILE)]


def read_attempts(root: Path) -> list[Attempt]:
    """Attempts that led to the dataset at ``root``, in the order of their seeds.

    Raises:
        DatasetError: there is no dataset of this project at ``root``.
    """
    require_dataset(root)
    return [Attempt(**line) for line in _lines(root / ATTEMPTS_FILE)]


def require_dataset(root: Path) -> None:
    """Check that ``root`` holds a finished dataset. Otherwise LeRobot would look for it on the network.

    Raises:
        DatasetError: it holds none.
    """
    if not root.is_dir():
        raise DatasetError(f"There is no dataset folder {root}.")
    for name in ("meta/info.json", "meta/episodes", "data", EPISODES_FILE):
        if not (root / name).exists():
            raise DatasetError(f"{root} is not a finished dataset of regrasp-collect: {name} is missing.")


def _lines(path: Path) -> list[dict[str, Any]]:
    try:
        return read_lines(path, strict=True)
    except (OSError, json.JSONDecodeError) as error:
        raise DatasetError(f"{path} cannot be read: {error}") from error
