"""The folder in which a dataset is collected, beside its final place, and how finished episodes are published.

``ROOT.collecting`` holds one small dataset per saved episode, the attempts so far and the settings. ``ROOT`` appears by
a single rename, so it is always whole.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from regrasp_datasets.records import (
    ATTEMPTS_FILE,
    Attempt,
    DatasetError,
    read_attempts,
    read_episodes,
    require_dataset,
)
from regrasp_datasets.shards import merge, remove_unfinished, shard_path, shard_seeds
from regrasp_gym.reports.files import acquire_lock, append_line, read_lines, rewrite_lines, write_json

SETTINGS_FILE = "meta/regrasp_collection.json"

RETRIED_OUTCOMES = ("timeout", "crashed")
"""Outcomes that a resumed collection retries: the seed need not be at fault."""


class WorkspaceError(DatasetError):
    """An output folder cannot be used as asked. The message says what to do."""


class Workspace:
    """State of one collection on disk; a context manager that holds the folder's lock.

    Args:
        root: final folder of the dataset.
        settings: settings that decide the content of episodes; a resumed collection must have the same.
        resume: continue an existing collection.

    Attributes:
        folder: the folder beside ``root``.
        shards, logs, plans: folders in it for episodes, workers' output and plans to be drawn.
        attempts: outcome of each seed so far.
        published: seeds of the episodes in the dataset at ``root``.

    Raises:
        WorkspaceError: the folder exists and ``resume`` is off, it was made with other settings, or another process is
            writing there.
    """

    def __init__(self, root: Path, settings: dict[str, Any], *, resume: bool) -> None:
        self.root = root
        self.folder = root.with_name(root.name + ".collecting")
        self.shards = self.folder / "episodes"
        self.logs = self.folder / "logs"
        self.plans = self.folder / "plans"
        self._settings = settings
        if not resume:
            if root.exists():
                raise WorkspaceError(
                    f"{root} exists already. Add --resume to add episodes to it, or choose another --root."
                )
            if self.folder.exists():
                raise WorkspaceError(
                    f"{self.folder} holds an unfinished collection. Add --resume to continue it, or remove it."
                )
        busy = WorkspaceError(f"Another regrasp-collect is writing to {root}.")
        self._lock = acquire_lock(self.folder / "lock", busy)
        self.shards.mkdir(exist_ok=True)
        self.logs.mkdir(exist_ok=True)
        self.plans.mkdir(exist_ok=True)
        try:
            self.attempts, self.published = self._load()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Workspace:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the lock; remove the folder if it holds neither episodes nor attempts."""
        if self.folder.exists() and not self._log.exists() and not shard_seeds(self.shards):
            shutil.rmtree(self.folder)
        self._lock.release()

    def add(self, attempt: Attempt) -> None:
        """Log the outcome of a seed."""
        self.attempts[attempt.seed] = attempt
        append_line(self._log, attempt)

    def publish(self, seeds: Sequence[int], attempts: Sequence[Attempt]) -> None:
        """Add the episodes of ``seeds`` to the dataset at ``root``, which is whole at every moment.

        Args:
            seeds: seeds of saved episodes, the published ones first.
            attempts: attempts that led to them.
        """
        from regrasp_datasets.card import write_card

        new = [seed for seed in seeds if seed not in self.published]
        if not new and self.root.exists():
            rewrite_lines(self.root / ATTEMPTS_FILE, attempts)
            return
        merged, replaced = self.folder / "merged", self.folder / "replaced"
        shutil.rmtree(merged, ignore_errors=True)
        sources = [self.root] if self.root.exists() else []
        merge([*sources, *(shard_path(self.shards, seed) for seed in new)], merged)
        rewrite_lines(merged / ATTEMPTS_FILE, attempts)
        write_json(merged / SETTINGS_FILE, self._settings)
        write_card(merged, name=self.root.name)
        if self.root.exists():
            self.root.rename(replaced)
        merged.rename(self.root)
        shutil.rmtree(replaced, ignore_errors=True)
        self.published |= set(new)
        for seed in new:
            shutil.rmtree(shard_path(self.shards, seed))

    def finish(self) -> None:
        """Remove the folder, once all episodes are published."""
        shutil.rmtree(self.folder)

    @property
    def _log(self) -> Path:
        return self.folder / "attempts.jsonl"

    def _load(self) -> tuple[dict[int, Attempt], set[int]]:
        remove_unfinished(self.shards)
        replaced = self.folder / "replaced"
        if replaced.exists() and not self.root.exists():
            # Killed between the two renames of `publish`.
            replaced.rename(self.root)
        attempts: dict[int, Attempt] = {}
        published: set[int] = set()
        if self.root.exists():
            require_dataset(self.root)
            self._compare(self.root / SETTINGS_FILE)
            attempts = {attempt.seed: attempt for attempt in read_attempts(self.root)}
            published = {record.seed for record in read_episodes(self.root)}
        local = self.folder / "settings.json"
        if local.exists():
            self._compare(local)
        else:
            write_json(local, self._settings)
        attempts |= self._logged()
        for seed in shard_seeds(self.shards):
            if seed in published:
                shutil.rmtree(shard_path(self.shards, seed))
            elif seed not in attempts or not attempts[seed].saved:
                attempts[seed] = self._attempt_of_shard(seed)
        present = published | set(shard_seeds(self.shards))
        attempts = {
            seed: attempt
            for seed, attempt in attempts.items()
            if attempt.outcome not in RETRIED_OUTCOMES and (seed in present or not attempt.saved)
        }
        if self._log.exists():
            rewrite_lines(self._log, attempts.values())
        return attempts, published

    def _logged(self) -> dict[int, Attempt]:
        """Attempts in the log. Lines half-written or of another version are skipped; their seeds are retried."""
        attempts: dict[int, Attempt] = {}
        for line in read_lines(self._log):
            with suppress(TypeError):
                attempt = Attempt(**line)
                attempts[attempt.seed] = attempt
        return attempts

    def _attempt_of_shard(self, seed: int) -> Attempt:
        record = read_episodes(shard_path(self.shards, seed))[0]
        return Attempt(
            seed,
            "success" if record.success else "execution failed",
            saved=True,
            target=record.target,
            stages=record.stages,
            planning_seconds=record.planning_seconds,
            frames=record.frames,
        )

    def _compare(self, path: Path) -> None:
        try:
            found = json.loads(path.read_text())
        except (OSError, json.JSONDecodeError) as error:
            raise WorkspaceError(f"{path} cannot be read, so {self.root} cannot be resumed: {error}") from error
        wanted = json.loads(json.dumps(self._settings))
        for key in sorted(wanted.keys() | found.keys()):
            if wanted.get(key) != found.get(key):
                raise WorkspaceError(
                    f"{self.root} was collected with {key} = {found.get(key)!r}, not {wanted.get(key)!r}: "
                    "resume with the same, or choose another --root."
                )
