"""Checks of configurations. Each raises a `SceneError` that names the field, its value and what it may be."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from regrasp_gym.errors import SceneError


def check_ranges(config: object, *fields: str, least: float = -math.inf) -> None:
    """Fields are (least, greatest) pairs, neither value below ``least``."""
    for field in fields:
        low, high = getattr(config, field)
        if not least <= low <= high:
            bound = "" if least == -math.inf else f", both at least {least:g}"
            raise SceneError(f"{field} is {(low, high)}; give the least value, then the greatest{bound}")


def check_positive(config: object, *fields: str) -> None:
    """Fields are numbers greater than 0."""
    for field in fields:
        value = getattr(config, field)
        if not np.min(value) > 0:
            raise SceneError(f"{field} is {value}; give more than 0")


def check_probabilities(config: object, *fields: str) -> None:
    """Fields are probabilities."""
    for field in fields:
        value = getattr(config, field)
        if not 0 <= value <= 1:
            raise SceneError(f"{field} is {value}; it is a probability, from 0 to 1")


def check_names(config: object, *fields: str, known: Collection[str], least: int = 1) -> None:
    """Fields are collections of at least ``least`` names, all known."""
    for field in fields:
        names = getattr(config, field)
        if len(names) < least:
            raise SceneError(f"{field} is empty; name at least one of {', '.join(known)}")
        for name in names:
            if name not in known:
                raise SceneError(f"unknown name {name!r} in {field}; choose from {', '.join(known)}")


def check_seed(seed: int, of: str) -> None:
    """The seed is not negative; ``of`` names what it is the seed of."""
    if seed < 0:
        raise SceneError(f"{of} seed is {seed}; give a non-negative integer")
