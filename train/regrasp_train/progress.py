"""How far an episode came, judged from the simulation alone.

The milestones are, in order:

- *taken*: only the gripper touches the target, for `HELD_STEPS` consecutive steps;
- *put down*: after that, the target rests on something, off its goal, and the gripper does not touch it;
- *re-taken*: after that, it is taken again;
- *placed*: the environment counts the task as solved, even if the target is still in the gripper.
"""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from regrasp_gym.envs.base import RegraspEnv

HELD_STEPS = 3
"""Steps that the target must be in the air to count as taken."""


class Milestone(IntEnum):
    """The last milestone of an episode."""

    NOTHING = 0
    TAKEN = 1
    PUT_DOWN = 2
    RETAKEN = 3
    PLACED = 4

    def __str__(self) -> str:
        return ("nothing", "taken", "put down", "re-taken", "placed")[self]


class Progress:
    """Watches one episode.

    Attributes:
        milestone: the last milestone so far.
    """

    def __init__(self) -> None:
        self.milestone = Milestone.NOTHING
        self._held = 0

    def watch(self, env: RegraspEnv) -> None:
        """Update from the current state; called once per step."""
        if env.is_success:
            self.milestone = Milestone.PLACED
            return
        world, tolerance = env.world, env.scenario.tolerance
        touched, supported = world.target_contacts()
        self._held = self._held + 1 if touched and not supported else 0
        if self._held >= HELD_STEPS:
            after = Milestone.RETAKEN if self.milestone >= Milestone.PUT_DOWN else Milestone.TAKEN
            self.milestone = max(self.milestone, after)
        slow = np.linalg.norm(world.target_velocity[:3]) <= tolerance.speed
        if self.milestone == Milestone.TAKEN and supported and not touched and slow:
            self.milestone = Milestone.PUT_DOWN
