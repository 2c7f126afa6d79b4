"""The configuration space in which paths are planned."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from regrasp_planner.collision.model import CollisionModel
from regrasp_planner.ik.line import ArmKinematics
from regrasp_planner.robot.model import Arm


@dataclass(frozen=True)
class ConfigurationSpace:
    """Configurations of an arm among the bodies it may hit, with its fingers at a fixed coordinate.

    Attributes:
        model: the robot, the obstacles, perhaps a held body; the pairs to check and their margins.
        theta: finger coordinate.
    """

    model: CollisionModel
    theta: float

    @property
    def arm(self) -> Arm:
        """The arm whose n joints span the space."""
        return self.model.arrays.robot.arm

    @cached_property
    def lower(self) -> Float[np.ndarray, " n"]:
        """Lower joint limits, radians."""
        return np.asarray(self.arm.lower, float)

    @cached_property
    def upper(self) -> Float[np.ndarray, " n"]:
        """Upper joint limits, radians."""
        return np.asarray(self.arm.upper, float)

    @cached_property
    def kinematics(self) -> ArmKinematics:
        """The arm's kinematics on the host."""
        return ArmKinematics(self.arm)

    def configuration(self, q: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """q as an array; raises ``ValueError`` if its shape is wrong or it is not finite. Limits are not checked."""
        q = np.asarray(q, float)
        if q.shape != (self.arm.dof,) or not np.isfinite(q).all():
            raise ValueError(f"a configuration must be {self.arm.dof} finite angles in radians, got {q}")
        return q

    def clipped(self, q: Float[np.ndarray, "*N n"]) -> Float[np.ndarray, "*N n"]:
        """q brought within the joint limits."""
        return np.clip(q, self.lower, self.upper)
