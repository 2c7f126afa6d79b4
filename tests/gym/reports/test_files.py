"""Files survive a process that is killed while it writes, and two processes that write at once."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from regrasp_gym.reports.files import (
    acquire_lock,
    append_line,
    read_lines,
    replacing,
    rewrite_lines,
    write_json,
    write_text,
)


@dataclass
class Point:
    x: int
    name: str = "a"


def test_a_file_is_written_whole_or_not_at_all(tmp_path):
    file = tmp_path / "new" / "a.txt"
    write_text(file, "old")
    with pytest.raises(UnicodeEncodeError), replacing(file) as temporary:
        temporary.write_text("half of the n\udc00", encoding="utf-8")
    assert file.read_text() == "old"
    with replacing(file) as temporary:
        assert temporary.suffix == file.suffix
        temporary.write_text("new")
    assert file.read_text() == "new"
    assert list(file.parent.iterdir()) == [file]


def test_a_crash_between_write_and_rename_leaves_the_old_file(tmp_path):
    file = tmp_path / "a.txt"
    write_text(file, "old")
    code = (
        "import os, sys; from pathlib import Path; from regrasp_gym.reports import files\n"
        "Path.replace = lambda *_: os._exit(9)\n"
        "files.write_text(Path(sys.argv[1]), 'new')"
    )
    assert subprocess.run([sys.executable, "-c", code, str(file)]).returncode == 9
    assert file.read_text() == "old"
    write_text(file, "newer")
    assert file.read_text() == "newer"


def test_json_holds_arrays_paths_and_dataclasses(tmp_path):
    content = {"a": np.float32(0.5), "b": np.arange(2), "c": Path("d"), "e": [Point(1)], "f": [np.inf, float("nan")]}
    write_json(tmp_path / "a.json", content)
    assert json.loads((tmp_path / "a.json").read_text()) == {
        "a": 0.5,
        "b": [0, 1],
        "c": "d",
        "e": [{"x": 1, "name": "a"}],
        "f": [None, None],
    }
    with pytest.raises(TypeError, match="of type object"):
        write_json(tmp_path / "b.json", object())
    assert not (tmp_path / "b.json").exists()


def test_lines_are_appended_after_a_half_written_one(tmp_path):
    file = tmp_path / "new" / "lines.jsonl"
    assert read_lines(file) == []
    append_line(file, Point(1))
    with file.open("a") as stream:
        stream.write('{"x": 5')
    append_line(file, {"x": 2})
    append_line(file, {"x": 3})
    assert [line["x"] for line in read_lines(file)] == [1, 2, 3]
    with pytest.raises(json.JSONDecodeError):
        read_lines(file, strict=True)


def test_lines_are_rewritten(tmp_path):
    file = tmp_path / "lines.jsonl"
    append_line(file, Point(1))
    rewrite_lines(file, [Point(2, 'a "quoted"\nline'), Point(3)])
    assert [Point(**line) for line in read_lines(file, strict=True)] == [Point(2, 'a "quoted"\nline'), Point(3)]
    with pytest.raises(FileNotFoundError):
        read_lines(tmp_path / "none.jsonl", strict=True)


def test_only_one_process_holds_a_lock(tmp_path):
    file = tmp_path / "new" / "lock"
    code = (
        "import sys; from pathlib import Path; from regrasp_gym.reports.files import acquire_lock\n"
        "lock = acquire_lock(Path(sys.argv[1]), RuntimeError('busy'))\n"
        "print('held', flush=True); input()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(file)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(RuntimeError, match="busy"):
            acquire_lock(file, RuntimeError("busy"))
        # The lock of a process that is killed is free.
        other.kill()
    lock = acquire_lock(file, RuntimeError("busy"))
    with pytest.raises(RuntimeError, match="busy"):
        acquire_lock(file, RuntimeError("busy"))
    lock.release()
    acquire_lock(file, RuntimeError("busy")).release()
