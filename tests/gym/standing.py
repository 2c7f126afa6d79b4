"""Objects as they stand upright."""

from __future__ import annotations

import numpy as np

from regrasp_gym.objects import ObjectModel


def upright(thing: ObjectModel, x: float = 0.0, y: float = 0.0) -> np.ndarray:
    """Pose (7,) of the upright object on z = 0."""
    lowest = min(piece[:, 2].min() for piece in thing.pieces)
    return np.array([1.0, 0, 0, 0, x, y, -lowest])
