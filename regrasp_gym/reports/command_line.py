"""What the commands have in common: how they end, their option ``--json``, and the extras that they need."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import gymnasium
import tyro
from rich.console import Console

from regrasp_gym.errors import MissingExtraError, RegraspGymError

JsonFile = Annotated[Path | None, tyro.conf.arg(name="json")]
"""Type of the option ``--json FILE``, for a field called ``json_file``. `regrasp_gym.reports.files.write_json` writes
the file."""

EXTRAS = {"lerobot": ("lerobot",), "rl": ("stable_baselines3", "tensorboard", "yaml", "tqdm")}
"""Modules that each extra installs."""


def run_command(name: str, work: Callable[[], int | None], *, resume: str = "") -> int:
    """Do the work of a command. What stops it is reported in one red line on standard error.

    Any other exception is a bug, and is raised.

    Args:
        name: the command, for messages.
        work: returns the exit code: 0 or None if all is done, 1 if it is done but something failed.
        resume: how to go on after Ctrl-C, where that is possible.

    Returns:
        The exit code: that of ``work``; 2 after an error of this project, Gymnasium or the operating system; 130 after
        Ctrl-C.
    """
    try:
        return work() or 0
    except KeyboardInterrupt:
        message, code = f"interrupted; {resume}" if resume else "interrupted", 130
    except _reported() as error:
        message, code = str(error), 2
    # Outside the handlers the error's frames are gone, and with them any progress bar, which would be drawn after it.
    console = Console(stderr=True)
    console.print(f"{name}: {message}", style="red", markup=False, highlight=False, soft_wrap=True)
    return code


def require_extra(command: str, extra: str) -> None:
    """Check that an extra is installed.

    Args:
        command: what needs it, for the message.
        extra: a key of `EXTRAS`.

    Raises:
        MissingExtraError: it is not.
    """
    missing = [module for module in EXTRAS[extra] if importlib.util.find_spec(module) is None]
    if missing:
        raise MissingExtraError(f"{command} needs {', '.join(missing)}: pip install 'regrasp-gym[{extra}]'")


def _reported() -> tuple[type[Exception], ...]:
    """Exceptions whose message is all that a user needs."""
    # Loading the planner would load JAX. As long as it is not loaded, it has raised nothing.
    planner = sys.modules.get("regrasp_planner.errors")
    return (RegraspGymError, gymnasium.error.Error, OSError, *((planner.RegraspError,) if planner else ()))
