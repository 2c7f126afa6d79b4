"""Wrappers that registered environments come with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np


class GoalReward(gymnasium.Wrapper):
    """Lets ``compute_reward`` through.

    Wrappers hide what they do not know, and the checks and replay buffers of goal-conditioned learning look for it on
    what `gymnasium.make` returns.
    """

    @property
    def compute_reward(self) -> Callable[[np.ndarray, np.ndarray, Any], np.ndarray]:
        """The environment's own; there is none unless observations have goals."""
        return self.env.get_wrapper_attr("compute_reward")
