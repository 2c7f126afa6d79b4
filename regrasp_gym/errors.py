"""Exceptions other than the planner's. Each message names the thing, its value and the fix."""

from __future__ import annotations


class RegraspGymError(Exception):
    """Base of all exceptions of environments, datasets, training and benchmarks."""


class EnvError(RegraspGymError):
    """Base of all exceptions of the environments."""


class ActionError(EnvError, ValueError):
    """An action of the wrong shape, or with entries that are not finite."""


class OptionError(EnvError, ValueError):
    """An unknown value of an environment's argument or of a reset option."""


class SceneError(EnvError, ValueError):
    """A scene that cannot be made: unknown objects, objects too wide for the gripper, an area too small."""


class StateError(EnvError, ValueError):
    """A saved state that does not belong to this environment."""


class DisplayError(EnvError, RuntimeError):
    """A window or an off-screen picture cannot be drawn on this machine."""


class BenchError(RegraspGymError, RuntimeError):
    """A benchmark that cannot be run here: a peer is not installed, a worker died, a figure has nothing to show."""


class MissingExtraError(RegraspGymError, ImportError):
    """A command needs an extra that is not installed."""
