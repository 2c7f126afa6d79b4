"""Whether the gripper clears the ground under the target, and in which direction it lets the target go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from regrasp_planner.grasp.grasp import FeasibleGrasp, Grasp
from regrasp_planner.grasp.open_gripper import OpenGripper
from regrasp_planner.grasp.problem import NO_PLANE
from regrasp_planner.placement.basins import ReleaseCone
from regrasp_planner.placement.tilted_release import BLOCKED, plane_clearance, relaxed_release, settling_clearance
from regrasp_planner.task import Body


class GroundCheck(NamedTuple):
    """K grasps over the ground.

    Attributes:
        release: for each grasp the (3,) direction that points down at its release; None without a ground there.
        clear: (K,) whether the gripper clears the ground at pick and release.
        planes: (K, 2, 4) planes of the ground at pick and release, as in `GraspProblem`.
    """

    release: list[Float[np.ndarray, " 3"] | None]
    clear: Bool[np.ndarray, " K"]
    planes: Float[np.ndarray, "K 2 4"]

    @staticmethod
    def unbounded(count: int) -> GroundCheck:
        """Grasps without any ground."""
        return GroundCheck([None] * count, np.ones(count, bool), np.tile(NO_PLANE, (count, 2, 1)))


@dataclass(frozen=True)
class Ground:
    """The ground under a target at pick and at release.

    Attributes:
        target: the target.
        hand: the gripper.
        start: the ground at pick, as the cone of a stable pose, of which only the axis counts; None for no ground.
        end: the ground at release, which may tilt within the cone; None for no ground.
    """

    target: Body
    hand: OpenGripper
    start: ReleaseCone | None
    end: ReleaseCone | None

    @property
    def tilts(self) -> bool:
        """Whether the release may be non-static (GraspGen⁺, Algorithm 3)."""
        return self.end is not None and self.end.half_angle > 0

    @property
    def exists(self) -> bool:
        """Whether there is a ground at pick or release."""
        return self.start is not None or self.end is not None

    def check(self, corners: Float[np.ndarray, "K G 3"]) -> GroundCheck:
        """Check K grasps, given the gripper's corners from `OpenGripper.corners`."""
        release, clear, planes = GroundCheck.unbounded(len(corners))
        hull, margin = self.target.hull_vertices(), self.hand.margin
        opened = corners[:, : corners.shape[1] // 2]
        if self.start is not None:
            planes[:, 0] = _plane(self.start.axis, hull)
            clear &= plane_clearance(hull, opened, self.start.axis) >= margin
        if self.end is not None:
            if self.tilts:
                down, free = relaxed_release(self.end, hull, corners, margin)
            else:
                down = np.tile(self.end.axis, (len(corners), 1))
                free = plane_clearance(hull, opened, self.end.axis) >= margin
            planes[:, 1] = _plane(down, hull)
            release, clear = list(down), clear & free
        return GroundCheck(release, clear, planes)

    def planes(self, poses: Float[np.ndarray, "K 7"], thetas: Float[np.ndarray, " K"]) -> Float[np.ndarray, "K 2 4"]:
        """Planes of the ground for K gripper poses and finger coordinates."""
        return self._check(poses, thetas).planes

    def feasible(self, grasps: Sequence[Grasp]) -> list[FeasibleGrasp]:
        """Those of the grasps that clear the ground."""
        if not grasps:
            return []
        poses, thetas = np.array([grasp.pose for grasp in grasps]), np.array([grasp.theta for grasp in grasps])
        release, clear, _ = self._check(poses, thetas)
        return self.settling([FeasibleGrasp(grasps[k], release[k]) for k in np.flatnonzero(clear)])

    def _check(self, poses: Float[np.ndarray, "K 7"], thetas: Float[np.ndarray, " K"]) -> GroundCheck:
        return self.check(self.hand.corners(poses, thetas)) if self.exists else GroundCheck.unbounded(len(poses))

    def settling(self, grasps: list[FeasibleGrasp]) -> list[FeasibleGrasp]:
        """Those of the grasps whose fingers, opened wide, do not block the target as it settles."""
        end = self.end
        if end is None or end.half_angle <= 0:
            return grasps
        tilted = [k for k, each in enumerate(grasps) if each.release is not None and each.release @ end.axis < 1]
        if not tilted:
            return grasps
        fingers = self.hand.wide_fingers(np.array([grasps[k].grasp.pose for k in tilted]))
        directions = np.array([grasps[k].release for k in tilted])
        pieces = [piece.hull_vertices() for piece in self.target.pieces]
        clearance = settling_clearance(pieces, fingers, end.axis, directions)
        blocked = {k for k, gap in zip(tilted, clearance, strict=True) if gap < BLOCKED * self.hand.length}
        return [each for k, each in enumerate(grasps) if k not in blocked]


def _plane(down: Float[np.ndarray, "*K 3"], hull: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "*K 4"]:
    """Planes (x, b) with downward normals x that support the hull from below."""
    return np.concatenate([down, (down @ hull.T).max(axis=-1)[..., None]], axis=-1)
