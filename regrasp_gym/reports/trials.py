"""Numbered trials, in several processes, whose records are kept so that an interrupted run resumes."""

from __future__ import annotations

import json
import multiprocessing
import signal
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from rich.console import Console
from rich.progress import track

from regrasp_gym.errors import BenchError
from regrasp_gym.reports.files import append_line, read_lines, to_line
from regrasp_gym.reports.report import Record

Trial = Callable[[int], Record]
"""Runs the trial of a number."""
Prepare = Callable[[Record], Trial]
"""Makes the function that runs trials, from what they have in common."""

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
    """Run numbered trials, and write each record as soon as its trial ends.

    Trials that ``records`` holds with the same setting are not run again, unless they crashed. Ctrl-C or a dead worker
    loses only the trials that are running.

    Args:
        setting: what the trials have in common; what JSON can hold.
        trials: their numbers, in the order in which they are run and returned.
        prepare: called once per process. A function of a module, so that another process can import it.
        workers: processes; 1 runs the trials in this one.
        records: file of one JSON line per trial, appended to.
        label: text of the progress bar.

    Returns:
        One record per trial, with ``setting`` and ``trial`` added. A trial that raised has ``crashed`` (the error) and
        ``traceback`` instead of its results.

    Raises:
        BenchError: a worker died.
    """
    setting = json.loads(to_line(setting))
    done = {r["trial"]: r for r in read_lines(records) if r.get("setting") == setting and "crashed" not in r}
    missing = [trial for trial in dict.fromkeys(trials) if trial not in done]
    if len(missing) < len(trials):
        message = f"{label}: {len(trials) - len(missing)} of {len(trials)} are in {records} already"
        Console().print(message, highlight=False)
    runs = _run(setting, missing, prepare, workers)
    for trial, record in track(runs, total=len(missing), description=label, disable=not missing):
        whole = {"setting": setting, "trial": trial, **record}
        append_line(records, whole)
        # As a later run will read it.
        done[trial] = json.loads(to_line(whole))
    return [done[trial] for trial in trials]


def crashes(records: Sequence[Record]) -> dict[str, list[int]]:
    """Trials that crashed, by error."""
    found: dict[str, list[int]] = {}
    for record in records:
        if "crashed" in record:
            found.setdefault(record["crashed"], []).append(record["trial"])
    return found


def print_crashes(crashed: Mapping[str, Sequence[int]], trials: str = "seeds", prefix: str = "") -> None:
    """Print what `crashes` found, in red.

    Args:
        crashed: trials by error.
        trials: what their numbers are.
        prefix: what the lines begin with.
    """
    for error, numbers in crashed.items():
        line = f"{prefix}crashed: {error}, {trials} {numbers}"
        Console().print(line, style="red", markup=False, highlight=False)


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
    # Ctrl-C reaches all processes; only this one reports it.
    quiet = (signal.SIGINT, signal.SIG_DFL)
    pool = ProcessPoolExecutor(min(workers, len(trials)), context, signal.signal, quiet)
    try:
        futures: dict[Future[Record], int] = {pool.submit(_trial, setting, prepare, trial): trial for trial in trials}
        for future in as_completed(futures):
            yield futures.pop(future), future.result()
    except BrokenProcessPool as error:
        raise BenchError("a worker died, perhaps out of memory: run again to resume, with fewer workers") from error
    finally:
        # Workers are idle after the last trial; before it, the run was interrupted.
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
        # A crash is a result, and must not lose the other trials.
        return {"crashed": f"{type(error).__name__}: {error}", "traceback": traceback.format_exc()}
