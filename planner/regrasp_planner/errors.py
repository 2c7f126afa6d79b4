"""Exceptions of the planner. Each message names the thing, its value and what to do about it."""

from __future__ import annotations


class RegraspError(Exception):
    """Base of every exception that the planner raises on purpose."""


class GeometryError(RegraspError, ValueError):
    """A shape that is no usable convex body: wrong array shape, not finite, too few points, or without volume."""


class StrategyError(RegraspError, ValueError):
    """A strategy that does not exist."""


class TaskError(RegraspError, ValueError):
    """A task that can not be planned as it stands: a bad pose, an empty target, a start outside the limits."""
