"""Wrappers of the registered environments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np


class GoalReward(gymnasium.Wrapper):
    """Forwards ``compute_reward``.

    Gymnasium's wrappers hide attributes that they do not know. Goal-conditioned checkers and replay buffers look for
    this one on the result of `gymnasium.make`.
    """

    @property
    def compute_reward(self) -> Callable[[np.ndarray, np.ndarray, Any], np.ndarray]:
        """The environment's reward function; missing unless observations have goals."""
        return self.env.get_wrapper_attr("compute_reward")
