"""The gripper opened around a target: lengths in its unit, finger coordinates, and corners of its bodies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from regrasp_planner.robot.gripper import gripper_points, reduce_gripper
from regrasp_planner.robot.model import Gripper


@dataclass(frozen=True)
class OpenGripper:
    """A gripper that opens for a target by the collision margin.

    Attributes:
        gripper: the gripper.
        length: its widest opening, metres.
        margin: collision margin δ_col, metres.
        travel: θ per metre that a finger moves.
    """

    gripper: Gripper
    length: float
    margin: float
    travel: float

    @staticmethod
    def of(gripper: Gripper, margin: float) -> OpenGripper:
        """The gripper with a margin in gripper openings."""
        length = float(gripper.max_opening)
        return OpenGripper(gripper, length, margin * length, reduce_gripper(gripper).travel)

    @property
    def stroke(self) -> float:
        """Unit of θ in a `GraspProblem`."""
        return self.length * self.travel

    @property
    def upper(self) -> float:
        """θ of the gripper opened as wide as possible."""
        return float(self.gripper.upper)

    def opened(self, thetas: Float[np.ndarray, "*K"] | float) -> Float[np.ndarray, "*K"]:
        """θ of the gripper opened around a target that the pads touch at ``thetas``."""
        return np.minimum(thetas + self.margin * self.travel, self.upper)

    def corners(self, poses: Float[np.ndarray, "K 7"], thetas: Float[np.ndarray, " K"]) -> Float[np.ndarray, "K G 3"]:
        """Corners of palm and fingers in the target's frame: first opened around the target, then opened wide."""
        wide = np.full(len(thetas), self.upper)
        parts = [part for theta in (self.opened(thetas), wide) for part in gripper_points(self.gripper, poses, theta)]
        return np.concatenate(parts, axis=1)

    def wide_fingers(self, poses: Float[np.ndarray, "K 7"]) -> list[Float[np.ndarray, "K G 3"]]:
        """Corners of both fingers, opened wide, in the target's frame."""
        return gripper_points(self.gripper, poses, np.full(len(poses), self.upper))[1:]
