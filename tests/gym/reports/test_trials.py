"""Trials: order, resuming, crashes, interruption."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numbered_trials
import psutil
import pytest
from numbered_trials import squares, unprepared

from regrasp_gym.errors import BenchError
from regrasp_gym.reports.files import read_lines
from regrasp_gym.reports.trials import crashes, run_trials

TRIALS = [3, 1, 4, 5]


def runs(trace: Path) -> dict[int, int]:
    return {int(file.name): len(file.read_text().splitlines()) for file in trace.iterdir()}


@pytest.fixture
def trace(tmp_path: Path) -> Path:
    folder = tmp_path / "trace"
    folder.mkdir()
    return folder


@pytest.mark.parametrize("workers", [1, 2])
def test_records_come_in_the_order_of_the_trials(workers: int, trace: Path, tmp_path: Path) -> None:
    setting = {"trace": str(trace), "options": (1, 2)}
    file = tmp_path / "new" / "records.jsonl"
    records = run_trials(setting, TRIALS, squares, workers=workers, records=file, label="squares")
    assert [record["trial"] for record in records] == TRIALS
    assert [record["square"] for record in records] == [9.0, 1.0, 16.0, 25.0]
    assert records[0]["range"] == [0, 1, 2]
    assert records[0]["setting"] == {"trace": str(trace), "options": [1, 2]}
    assert sorted(read_lines(file), key=lambda record: TRIALS.index(record["trial"])) == records


def test_only_what_is_missing_is_run(trace: Path, tmp_path: Path) -> None:
    setting, file = {"trace": str(trace)}, tmp_path / "records.jsonl"
    first = run_trials(setting, TRIALS[:2], squares, workers=1, records=file, label="squares")
    # A killed run leaves half a line, which must cost neither what is before it nor what comes after.
    with file.open("a") as text:
        text.write('{"setting": {"tra')
    both = run_trials(setting, TRIALS, squares, workers=1, records=file, label="squares")
    assert both[:2] == first
    assert runs(trace) == dict.fromkeys(TRIALS, 1)
    again = run_trials(setting, TRIALS, squares, workers=1, records=file, label="squares")
    assert again == both
    assert runs(trace) == dict.fromkeys(TRIALS, 1)


def test_another_setting_is_run_anew(trace: Path, tmp_path: Path) -> None:
    file = tmp_path / "records.jsonl"
    for version in ("1", "2", "1"):
        setting = {"trace": str(trace), "version": version}
        records = run_trials(setting, [2], squares, workers=1, records=file, label="squares")
        assert records[0]["setting"]["version"] == version
    assert runs(trace) == {2: 2}


def test_a_crash_is_a_record_and_is_tried_again(trace: Path, tmp_path: Path) -> None:
    file = tmp_path / "records.jsonl"
    setting = {"trace": str(trace), "fails": [4]}
    records = run_trials(setting, TRIALS, squares, workers=1, records=file, label="squares")
    assert [record.get("crashed") for record in records] == [None, None, "ArithmeticError: trial 4 does not work", None]
    run_trials(setting, TRIALS, squares, workers=1, records=file, label="squares")
    assert runs(trace) == {3: 1, 1: 1, 4: 2, 5: 1}


def test_a_dead_worker_is_reported_and_nothing_done_is_lost(trace: Path, tmp_path: Path) -> None:
    file = tmp_path / "records.jsonl"
    setting = {"trace": str(trace), "exits": 5}
    with pytest.raises(BenchError, match="run again"):
        run_trials(setting, [1, 2, 3, 4, 5], squares, workers=2, records=file, label="squares")
    kept = [record["trial"] for record in read_lines(file)]
    assert kept
    assert 5 not in kept
    run_trials(setting, kept, squares, workers=1, records=file, label="squares")
    assert all(runs(trace)[trial] == 1 for trial in kept)


def test_what_prepare_raises_ends_the_run(trace: Path, tmp_path: Path) -> None:
    file = tmp_path / "records.jsonl"
    for workers in (1, 2):
        with pytest.raises(BenchError, match="nothing to run with"):
            run_trials({"trace": str(trace)}, [1, 2], unprepared, workers=workers, records=file, label="none")


@pytest.mark.parametrize("workers", [1, 2])
def test_an_interrupted_run_keeps_what_is_done(workers: int, trace: Path, tmp_path: Path) -> None:
    file = tmp_path / "records.jsonl"
    command = [sys.executable, numbered_trials.__file__, str(trace), str(file), str(workers)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        deadline = time.monotonic() + 60
        while len(read_lines(file)) < 3:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)
    assert process.returncode != 0
    for worker in {int(line) for one in trace.iterdir() for line in one.read_text().split()}:
        assert not psutil.pid_exists(worker)
    kept = [record["trial"] for record in read_lines(file)]
    assert 3 <= len(kept) < 40
    setting = {"trace": str(trace), "pause": 0.3}
    run_trials(setting, kept, squares, workers=1, records=file, label="squares")
    assert all(runs(trace)[trial] == 1 for trial in kept)


def test_crashes_are_grouped_by_error(trace: Path, tmp_path: Path) -> None:
    setting = {"trace": str(trace), "fails": [4, 5]}
    file = tmp_path / "records.jsonl"
    records = run_trials(setting, TRIALS, squares, workers=1, records=file, label="squares")
    assert crashes(records) == {
        "ArithmeticError: trial 4 does not work": [4],
        "ArithmeticError: trial 5 does not work": [5],
    }
    assert "numbered_trials" in records[2]["traceback"]
