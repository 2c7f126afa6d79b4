"""The dataset card: a README in Hugging Face's format, generated from the dataset."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np

from regrasp_datasets.features import IMAGE_PREFIX, MEANING
from regrasp_datasets.records import failure_causes, read_attempts, read_episodes

CARD_FILE = "README.md"


def write_card(root: Path, *, name: str | None = None) -> None:
    """Write ``README.md`` into the dataset at ``root``.

    Args:
        root: a finished dataset.
        name: title; the folder's name by default.

    Raises:
        DatasetError: there is no dataset at ``root``.
    """
    (root / CARD_FILE).write_text(card(root, name=name or root.name))


def card(root: Path, *, name: str) -> str:
    """Text of the card; every figure is counted in the dataset.

    Raises:
        DatasetError: there is no dataset at ``root``.
    """
    records, attempts = read_episodes(root), read_attempts(root)
    info = json.loads((root / "meta/info.json").read_text())
    first = records[0]
    frames = np.array([record.frames for record in records])
    planning = np.array([record.planning_seconds for record in records])
    executed = sum(attempt.frames > 0 for attempt in attempts)
    succeeded = sum(attempt.outcome == "success" for attempt in attempts)
    by_target = Counter(record.target for record in records)
    causes = failure_causes(attempts)
    features = [
        f"| `{key}` | {feature['dtype']} | {_shape(feature['shape'])} | {_meaning(key)} |"
        for key, feature in info["features"].items()
        if key in MEANING or key.startswith(IMAGE_PREFIX)
    ]
    lines = [
        "---",
        "license: apache-2.0",
        "task_categories:",
        "- robotics",
        "tags:",
        "- LeRobot",
        "- regrasp-gym",
        "configs:",
        "- config_name: default",
        "  data_files: data/*/*.parquet",
        "---",
        "",
        f"# {name}",
        "",
        f"Demonstrations of `{first.env_id}`, planned and executed by regrasp-gym's expert (strategy "
        f"`{first.strategy}`) in MuJoCo. LeRobot format {info['codebase_version']}, {info['fps']} frames per second.",
        "",
        "| | |",
        "|---|---|",
        f"| episodes | {len(records)} |",
        f"| of them successful | {sum(record.success for record in records)} |",
        f"| of them with a regrasp | {sum(record.stages >= 2 for record in records)} |",
        f"| frames | {frames.sum()} ({frames.min()} to {frames.max()} per episode, median {np.median(frames):.0f}) |",
        f"| seeds | {min(r.seed for r in records)} to {max(r.seed for r in records)} |",
        f"| seeds tried | {len(attempts)}: {executed} executed, {succeeded} succeeded |",
        f"| planning per episode | median {np.median(planning):.2f} s, longest {planning.max():.2f} s |",
        f"| environment | `gym.make({first.env_id!r}, {_arguments(first.env_kwargs)})` |",
        f"| versions | {', '.join(f'{key} {value}' for key, value in first.versions.items())} |",
        "",
        "## Features",
        "",
        "| key | dtype | shape | what |",
        "|---|---|---|---|",
        *features,
        "",
        "## Objects",
        "",
        "| object | episodes |",
        "|---|---|",
        *(f"| {target} | {count} |" for target, count in sorted(by_target.items())),
        "",
    ]
    if causes:
        lines += [
            "## Failed seeds",
            "",
            "| why | seeds |",
            "|---|---|",
            *(f"| {cause} | {count} |" for cause, count in causes.most_common()),
            "",
        ]
    lines += [
        "## Replaying an episode",
        "",
        "`meta/regrasp_episodes.jsonl` holds the seed, the environment and digests of the first and last physics state",
        "of every episode. `regrasp-replay --root FOLDER` runs all actions again and compares to the last bit.",
        "",
    ]
    return "\n".join(lines)


def _shape(shape: list[int]) -> str:
    return " × ".join(str(length) for length in shape)


def _meaning(key: str) -> str:
    if key.startswith(IMAGE_PREFIX):
        return f"camera `{key.removeprefix(IMAGE_PREFIX)}`, before the step"
    return MEANING[key]


def _arguments(kwargs: dict[str, object]) -> str:
    return ", ".join(f"{key}={value!r}" for key, value in kwargs.items())
