"""Collections that are killed, interrupted and resumed lose nothing and repeat nothing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

pytest.importorskip("lerobot")

from rich.console import Console

from regrasp_datasets.records import read_episodes
from regrasp_datasets.replay import ReplayOptions, replay
from regrasp_datasets.verify import require_valid

pytestmark = [pytest.mark.lerobot, pytest.mark.slow]

HERE = Path(__file__).parent
WAIT = 120.0


def start(root: Path, *more: str) -> subprocess.Popen:
    command = [sys.executable, "-m", "regrasp_datasets.collect", "--root", str(root), "--episodes", "5", "--no-images"]
    command += ["--keep-failures", "--expert", "scripted_experts:SlowExpert", "--workers", "2", *more]
    environment = os.environ | {"PYTHONPATH": str(HERE)}
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )


def finished(process: subprocess.Popen, timeout: float = WAIT) -> tuple[int, str]:
    output, _ = process.communicate(timeout=timeout)
    return process.returncode, output


def wait_for(condition, process: subprocess.Popen) -> None:
    deadline = time.monotonic() + WAIT
    while not condition():
        assert process.poll() is None, process.stdout.read()
        assert time.monotonic() < deadline
        time.sleep(0.02)


def episodes_in(folder: Path) -> list[Path]:
    return sorted(folder.glob("episodes/seed-*"))


def workers_of(process: subprocess.Popen) -> list[psutil.Process]:
    return [
        child
        for child in psutil.Process(process.pid).children(recursive=True)
        if "spawn_main" in " ".join(child.cmdline())
    ]


@pytest.fixture(autouse=True)
def importable_expert(monkeypatch):
    monkeypatch.syspath_prepend(str(HERE))


def test_killed_collection_resumes_where_it_was(tmp_path):
    root = tmp_path / "killed"
    folder = tmp_path / "killed.collecting"
    process = start(root)
    wait_for(lambda: len(episodes_in(folder)) >= 2, process)
    workers = workers_of(process)
    assert len(workers) == 2
    process.kill()
    process.wait()
    psutil.wait_procs(workers, timeout=20)
    assert not any(worker.is_running() and worker.status() != psutil.STATUS_ZOMBIE for worker in workers)

    assert not root.exists()
    saved = episodes_in(folder)
    for episode in saved:
        require_valid(episode)
    untouched = {episode.name: episode.stat().st_mtime_ns for episode in saved}

    code, output = finished(start(root))
    assert code == 2
    assert "--resume" in output

    process = start(root, "--resume")
    wait_for(lambda: len(episodes_in(folder)) > len(saved) or root.exists(), process)
    for episode in episodes_in(folder):
        if episode.name in untouched:
            assert episode.stat().st_mtime_ns == untouched[episode.name], "an episode was made twice"
    code, output = finished(process)
    assert code == 0, output
    # Seed 4 never finds a plan.
    assert [record.seed for record in read_episodes(root)] == [0, 1, 2, 3, 5]
    assert replay(ReplayOptions(root), Console(quiet=True)) == 0


def test_dead_worker_is_replaced_and_its_seed_tried_again(tmp_path):
    root = tmp_path / "dead"
    process = start(root)
    wait_for(lambda: len(episodes_in(tmp_path / "dead.collecting")) >= 1, process)
    workers_of(process)[0].kill()
    code, output = finished(process)
    assert code == 0, output
    assert [record.seed for record in read_episodes(root)] == [0, 1, 2, 3, 5]


def test_ctrl_c_leaves_a_readable_dataset(tmp_path):
    root = tmp_path / "interrupted"
    folder = tmp_path / "interrupted.collecting"
    process = start(root)
    wait_for(lambda: (folder / "episodes/seed-00000000").exists() and len(episodes_in(folder)) >= 2, process)
    # As a terminal does it: the whole group gets the signal.
    os.killpg(process.pid, signal.SIGINT)
    code, output = finished(process)
    assert code == 130, output
    assert "Traceback" not in output
    assert "--resume" in output
    require_valid(root)
    kept = [record.seed for record in read_episodes(root)]
    assert kept[0] == 0

    code, output = finished(start(root, "--resume"))
    assert code == 0, output
    assert [record.seed for record in read_episodes(root)] == [0, 1, 2, 3, 5]
    assert not folder.exists()
