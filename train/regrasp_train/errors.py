"""Exceptions of training and evaluation. Each message names the thing, its value and what to do about it."""

from __future__ import annotations

import importlib.util


class TrainError(Exception):
    """Base of every exception that training and evaluation raise on purpose."""


class MissingExtraError(TrainError, ImportError):
    """A command needs packages of an extra that is not installed."""


class MismatchError(TrainError, ValueError):
    """A dataset, a checkpoint and an environment that do not fit together."""


class RunError(TrainError, RuntimeError):
    """A folder of a run that cannot be used as asked, or a configuration that cannot be read."""


EXTRAS = {"lerobot": ("lerobot",), "rl": ("stable_baselines3", "tensorboard", "yaml", "tqdm")}
"""Modules that each extra brings."""


def require_extra(command: str, extra: str) -> None:
    """Raise `MissingExtraError` unless all modules of an extra can be imported.

    Args:
        command: who needs it, for the message.
        extra: a key of `EXTRAS`.
    """
    missing = [module for module in EXTRAS[extra] if importlib.util.find_spec(module) is None]
    if missing:
        raise MissingExtraError(f"{command} needs {', '.join(missing)}: pip install 'regrasp-gym[{extra}]'")
