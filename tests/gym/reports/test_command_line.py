"""Commands end in one way: an exit code, and one line for what stopped them."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import gymnasium
import pytest
import tyro

from regrasp_gym.errors import MissingExtraError, SceneError
from regrasp_gym.reports.command_line import JsonFile, require_extra, run_command


def failing(error: BaseException):
    def work() -> int:
        raise error

    return work


@pytest.mark.parametrize(("returned", "code"), [(None, 0), (0, 0), (1, 1)])
def test_the_exit_code_is_that_of_the_work(returned, code, capsys):
    assert run_command("regrasp-x", lambda: returned) == code
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    "error",
    [
        SceneError("no room for [bold]12[/] objects"),
        gymnasium.error.NameNotFound("no environment [x]"),
        FileNotFoundError(2, "No such file or directory", "/a/" + 200 * "b" + "/c.txt"),
    ],
)
def test_an_error_of_the_user_is_one_line(error, capsys):
    assert run_command("regrasp-x", failing(error)) == 2
    assert capsys.readouterr().err == f"regrasp-x: {error}\n"


def test_an_error_of_the_planner_is_one_line(capsys):
    from regrasp_planner import TaskError

    assert run_command("regrasp-x", failing(TaskError("no target"))) == 2
    assert capsys.readouterr().err == "regrasp-x: no target\n"


def test_a_bug_is_raised():
    with pytest.raises(ZeroDivisionError):
        run_command("regrasp-x", failing(ZeroDivisionError()))


@pytest.mark.parametrize(
    ("resume", "message"),
    [("", "regrasp-x: interrupted\n"), ("go on with --resume", "regrasp-x: interrupted; go on with --resume\n")],
)
def test_ctrl_c_says_how_to_go_on(resume, message, capsys):
    assert run_command("regrasp-x", failing(KeyboardInterrupt()), resume=resume) == 130
    assert capsys.readouterr().err == message


def test_a_progress_bar_is_closed_before_the_message():
    """Otherwise the bar is drawn once more, after the message."""
    code = (
        "import sys; from rich import reconfigure; reconfigure(force_terminal=True, width=80)\n"
        "from rich.progress import track; from regrasp_gym.errors import SceneError\n"
        "from regrasp_gym.reports.command_line import run_command\n"
        "def work():\n"
        "    for index in track(range(3)):\n"
        "        if index: raise SceneError('no room')\n"
        "sys.exit(run_command('regrasp-x', work))"
    )
    both = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    done = subprocess.run([sys.executable, "-c", code], **both)
    assert done.returncode == 2
    shows_cursor = "\x1b[?25h"
    assert done.stdout.index(shows_cursor) < done.stdout.index("no room")
    assert "Working" not in done.stdout[done.stdout.index("no room") :]


@dataclass(frozen=True)
class Options:
    json_file: JsonFile = None
    """File for the result."""


def test_json_is_an_option():
    assert tyro.cli(Options, args=["--json", "a.json"]).json_file == Path("a.json")
    assert tyro.cli(Options, args=[]).json_file is None


@pytest.mark.parametrize(("extra", "module"), [("lerobot", "lerobot"), ("rl", "stable_baselines3")])
def test_missing_extra_is_named(monkeypatch, extra, module):
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name == module else found(name, *rest))
    with pytest.raises(MissingExtraError, match=rf"regrasp-x needs {module}.*regrasp-gym\[{extra}\]"):
        require_extra("regrasp-x", extra)


def test_the_helpers_load_no_planner():
    code = "import sys, regrasp_gym.reports.command_line; print('jax' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
