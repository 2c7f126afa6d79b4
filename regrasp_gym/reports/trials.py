"""What all benchmarks share: trials that resume, reports that say what they were made with, and optional peers."""

from __future__ import annotations

import contextlib
import importlib
import json
import multiprocessing
import os
import platform
import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from regrasp_gym.errors import BenchError

Record = dict[str, Any]
Trial = Callable[[int], Record]
Prepare = Callable[[Record], Trial]

_PROCESS: dict[str, Trial] = {}


def run_trials(
    setting: Record,
    trials: Sequence[int],
    prepare: Prepare,
    *,
    workers: int,
    records: Path,
    label: str,
) -> list[Record]:
    """Run numbered trials, keeping each one's record as soon as it is there.

    Trials that ``records`` holds with the same setting are not run again, unless they crashed. Ctrl-C, or a process
    that dies, costs only the trials being run.

    Args:
        setting: what the trials have in common; what JSON can hold.
        trials: their numbers, in the order in which they are run and returned.
        prepare: makes, once per process, the function from a trial's number to its record. A function of a module,
            so that another process can import it.
        workers: processes; 1 runs the trials in this one.
        records: file of one JSON line per trial, appended to.
        label: what the progress bar says.

    Returns:
        One record per trial, with ``setting`` and ``trial`` added. A trial that raised has ``crashed`` (the error) and
        ``traceback`` instead of what ``prepare``'s function gives.

    Raises:
        BenchError: a worker died.
    """
    setting = json.loads(_line(setting))
    done = {r["trial"]: r for r in read_records(records) if r.get("setting") == setting and "crashed" not in r}
    missing = [trial for trial in dict.fromkeys(trials) if trial not in done]
    if len(missing) < len(trials):
        message = f"{label}: {len(trials) - len(missing)} of {len(trials)} are in {records} already"
        Console().print(message, highlight=False)
    records.parent.mkdir(parents=True, exist_ok=True)
    with records.open("ab+") as file:
        if _ends_within_line(records):
            file.write(b"\n")
        runs = _run(setting, missing, prepare, workers)
        for trial, record in track(runs, total=len(missing), description=label, disable=not missing):
            line = _line({"setting": setting, "trial": trial, **record})
            file.write(line.encode() + b"\n")
            file.flush()
            done[trial] = json.loads(line)
    return [done[trial] for trial in trials]


def read_records(path: Path) -> list[Record]:
    """Records in a file of JSON lines, empty if there is no such file; half-written lines are left out."""
    found: list[Any] = []
    for line in path.read_text().splitlines() if path.exists() else []:
        with contextlib.suppress(json.JSONDecodeError):
            found.append(json.loads(line))
    return [record for record in found if isinstance(record, dict)]


def write_report(
    json_file: Path | None,
    report: Record,
    packages: Sequence[str] = ("regrasp-gym", "mujoco", "jax", "numpy", "scipy"),
) -> None:
    """Write a report as JSON, with the versions of ``packages`` and the machine; nothing if there is no file.

    Numbers that are not finite, which JSON does not know, become null.
    """
    if json_file is None:
        return
    made_with = {"versions": {name: version(name) for name in packages}, "machine": machine()}
    json_file.parent.mkdir(parents=True, exist_ok=True)
    json_file.write_text(json.dumps(_finite(json.loads(_line({**report, **made_with}))), indent=2) + "\n")


def machine() -> str:
    """Processor and number of cores of this machine."""
    name = platform.processor() or platform.machine()
    with contextlib.suppress(OSError, StopIteration):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        name = next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return f"{name}, {os.cpu_count()} cores"


def crashes(records: Sequence[Record]) -> dict[str, list[int]]:
    """Trials that crashed, by what they raised."""
    found: dict[str, list[int]] = {}
    for record in records:
        if "crashed" in record:
            found.setdefault(record["crashed"], []).append(record["trial"])
    return found


def wilson(count: int, total: int) -> tuple[float, float]:
    """95 % confidence interval of a share of ``count`` among ``total`` trials (Wilson 1927); (0, 1) without trials."""
    if total == 0:
        return 0.0, 1.0
    z = 1.959964
    center = count + 0.5 * z**2
    spread = z * np.sqrt(count * (total - count) / total + 0.25 * z**2)
    low, high = (center - spread) / (total + z**2), (center + spread) / (total + z**2)
    return max(float(low), 0.0), min(float(high), 1.0)


def peer(module: str) -> ModuleType:
    """Import a module of the extra ``bench``.

    Raises:
        BenchError: it cannot be imported.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        message = f"this benchmark needs {module}: pip install 'regrasp-gym[bench]' ({error})"
        raise BenchError(message) from error


def _run(setting: Record, trials: list[int], prepare: Prepare, workers: int) -> Iterator[tuple[int, Record]]:
    if not trials:
        return
    if workers <= 1:
        run = prepare(setting)
        for trial in trials:
            yield trial, _guarded(run, trial)
        return
    others = set(multiprocessing.active_children())
    # Spawned, not forked: JAX runs threads.
    context = multiprocessing.get_context("spawn")
    # Ctrl-C reaches all processes; only this one has something to say about it.
    quiet = (signal.SIGINT, signal.SIG_DFL)
    pool = ProcessPoolExecutor(min(workers, len(trials)), context, signal.signal, quiet)
    try:
        futures: dict[Future[Record], int] = {pool.submit(_trial, setting, prepare, trial): trial for trial in trials}
        for future in as_completed(futures):
            yield futures.pop(future), future.result()
    except BrokenProcessPool as error:
        raise BenchError("a worker died, perhaps for want of memory: run again to go on, with fewer workers") from error
    finally:
        # After the last trial they have nothing to do; before it, somebody has interrupted them.
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()


def _trial(setting: Record, prepare: Prepare, trial: int) -> Record:
    if "run" not in _PROCESS:
        _PROCESS["run"] = prepare(setting)
    return _guarded(_PROCESS["run"], trial)


def _guarded(run: Trial, trial: int) -> Record:
    try:
        return run(trial)
    except Exception as error:
        # One trial that crashes is a result like any other, and must not cost those of the others.
        return {"crashed": f"{type(error).__name__}: {error}", "traceback": traceback.format_exc()}


def _ends_within_line(path: Path) -> bool:
    text = path.read_bytes()
    return bool(text) and not text.endswith(b"\n")


def _line(record: Record) -> str:
    return json.dumps(record, default=_plain)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"a record cannot hold {value!r} of type {type(value).__name__}")
