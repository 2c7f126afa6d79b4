"""What is asked of PathPlan."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from regrasp_planner.path.options import PathOptions
from regrasp_planner.path.space import ConfigurationSpace


@dataclass(frozen=True)
class PathQuery:
    """A motion from one configuration to another.

    Attributes:
        space: the robot, what it may hit, and its finger coordinate.
        start, goal: (n,) configurations, radians.
        options: see `PathOptions`.
    """

    space: ConfigurationSpace
    start: Float[np.ndarray, " n"]
    goal: Float[np.ndarray, " n"]
    options: PathOptions = field(default_factory=PathOptions)


@dataclass(frozen=True)
class LineQuery:
    """A straight motion of the gripper with fixed orientation.

    Attributes:
        space: as in `PathQuery`; pairs meant to touch (pads and target) are left out of its model.
        start: (n,) configuration, radians.
        displacement: (3,) of the gripper in world axes, metres.
        options: see `PathOptions`.
    """

    space: ConfigurationSpace
    start: Float[np.ndarray, " n"]
    displacement: Float[np.ndarray, " 3"]
    options: PathOptions = field(default_factory=PathOptions)
