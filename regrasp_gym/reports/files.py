"""Files that survive a crash: written whole or not at all, JSON lines that are appended to, and locks."""

from __future__ import annotations

import json
import math
import os
import uuid
from collections.abc import Generator, Iterable
from contextlib import contextmanager, suppress
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout


@contextmanager
def replacing(path: Path) -> Generator[Path]:
    """Yield a temporary file beside ``path``, which is renamed to ``path`` if the block succeeds.

    Whatever kills the process, ``path`` holds the old content or the new one. Its folder is made. The temporary name
    has the suffix of ``path``, and is never shared by two writers of the same file.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{uuid.uuid4().hex[:8]}.tmp{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text)


def write_json(path: Path, content: object) -> None:
    """Write indented JSON, whole or not at all.

    Args:
        path: file to write.
        content: may hold dataclasses, arrays and paths. Numbers that are not finite, which JSON lacks, become null.

    Raises:
        TypeError: it holds something else that JSON lacks.
    """
    write_text(path, json.dumps(_finite(json.loads(to_line(content))), indent=2) + "\n")


def to_line(item: object) -> str:
    """One line of JSON, without the line break. Dataclasses, arrays and paths are converted.

    Raises:
        TypeError: ``item`` holds something else that JSON lacks.
    """
    return json.dumps(item, default=_plain)


def read_lines(path: Path, *, strict: bool = False) -> list[dict[str, Any]]:
    """Objects in a file of JSON lines; none if there is no such file.

    Args:
        path: file to read.
        strict: fail where the file is missing or damaged. Otherwise half-written lines are skipped: a process that is
            killed leaves one.

    Raises:
        OSError: the file cannot be read.
        json.JSONDecodeError: with ``strict``, a line is not JSON.
    """
    if strict:
        return [json.loads(line) for line in path.read_text().splitlines() if line]
    found: list[Any] = []
    for line in path.read_text().splitlines() if path.exists() else []:
        with suppress(json.JSONDecodeError):
            found.append(json.loads(line))
    return [item for item in found if isinstance(item, dict)]


def append_line(path: Path, item: object) -> None:
    """Append one JSON line. If the last line is half-written, it is ended first."""
    path.parent.mkdir(parents=True, exist_ok=True)
    line = to_line(item).encode() + b"\n"
    with path.open("ab+") as file:
        if file.seek(0, os.SEEK_END) > 0:
            file.seek(-1, os.SEEK_END)
            if file.read(1) != b"\n":
                line = b"\n" + line
        file.write(line)


def rewrite_lines(path: Path, items: Iterable[object]) -> None:
    """Write a file of JSON lines, whole or not at all."""
    write_text(path, "".join(to_line(item) + "\n" for item in items))


def acquire_lock(path: Path, busy: Exception) -> FileLock:
    """Lock a file against other processes, until it is released or the process ends. Its folder is made.

    Args:
        path: the lock file. It stays after the release.
        busy: what to raise if another process holds the lock.

    Raises:
        Exception: ``busy``.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(path)
    try:
        lock.acquire(blocking=False)
    except Timeout as error:
        raise busy from error
    return lock


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _plain(value: object) -> object:
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"JSON cannot hold {value!r} of type {type(value).__name__}")
