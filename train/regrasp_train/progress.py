"""How far an episode came, from what the simulation says, whoever acts.

The steps up to the goal are, in order:

- *taken*: the gripper touches the target and nothing else does, for `HELD_STEPS` steps on end;
- *put down*: after that, the target rests on something, off its goal, and the gripper does not touch it;
- *re-taken*: after that, it is taken once more;
- *placed*: the environment counts the task as solved. Where it is solved with the target in the hand, this too.
"""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from regrasp_gym.envs.base import RegraspEnv

HELD_STEPS = 3
"""Steps that the target has to be in the air before it counts as taken."""


class Reached(IntEnum):
    """The farthest of the steps that an episode came to."""

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
        reached: the farthest step so far.
    """

    def __init__(self) -> None:
        self.reached = Reached.NOTHING
        self._held = 0

    def watch(self, env: RegraspEnv) -> None:
        """Look at the present state, once per step."""
        if env.is_success:
            self.reached = Reached.PLACED
            return
        world, tolerance = env.world, env.scenario.tolerance
        touched, supported = world.target_contacts()
        self._held = self._held + 1 if touched and not supported else 0
        if self._held >= HELD_STEPS:
            after = Reached.RETAKEN if self.reached >= Reached.PUT_DOWN else Reached.TAKEN
            self.reached = max(self.reached, after)
        slow = np.linalg.norm(world.target_velocity[:3]) <= tolerance.speed
        if self.reached == Reached.TAKEN and supported and not touched and slow:
            self.reached = Reached.PUT_DOWN
