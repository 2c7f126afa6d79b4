"""Exceptions of training and evaluation. Each message names the thing, its value and the fix."""

from __future__ import annotations

from regrasp_gym.errors import RegraspGymError


class MismatchError(RegraspGymError, ValueError):
    """A dataset, a checkpoint and an environment do not fit together."""


class RunError(RegraspGymError, RuntimeError):
    """The folder of a run cannot be used as asked, or a config cannot be read."""
