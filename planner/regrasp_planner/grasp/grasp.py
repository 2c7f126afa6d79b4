"""What a grasp is, and what to ask of one."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from regrasp_planner.pose import Pose, rigid, wxyz_xyz


@dataclass(frozen=True)
class Grasp:
    """A grasp X = (g_G, θ_G) of the target.

    Attributes:
        pose: (7,) gripper frame in the frame of the target.
        theta: finger coordinate at which both pads touch, in the gripper's unit.
        opening: finger coordinate of the open gripper around the target, before closing and after opening.
        quality: f = f_anti + f_align, at most 2.
        clearance: least signed distance of the open gripper from the obstacles of all scenes, and of its palm from the
            target, metres.
    """

    pose: Pose
    theta: float
    opening: float
    quality: float
    clearance: float

    def gripper_pose(self, target_pose: Pose) -> Pose:
        """Pose of the gripper (7,) in the world when the target is at ``target_pose``."""
        return wxyz_xyz(rigid(target_pose) * rigid(self.pose))


class StartKind(StrEnum):
    """Where GraspGen starts."""

    CRITICAL = "critical"
    """Critical directions of the width function, put in order by bounding boxes; see `grasp_starts`."""
    UNIFORM = "uniform"
    """The paper's plain multi-start: gripper poses at random about the target, all of them refined."""


@dataclass(frozen=True)
class GraspGenOptions:
    """Options of `GraspSearch` and `generate_grasps`.

    Attributes:
        margin: collision margin δ_col of the open gripper from obstacles, metres per metre of gripper opening, so
            that one value suits grippers of any size (0.06 is 5 mm for an 80 mm gripper).
        depth: how deep the grasp centre has to lie in the target, as a share of how far the fingers reach beyond it.
        quality_threshold: f_threshold of eq. (1).
        starts: where to start.
        max_axes: closing axes taken from the width function.
        lean: largest angle between these axes and the line between the contacts, radians; 0 for the minima alone.
        angles: approach angles about each axis; twice as many where there are few axes.
        deep: overlap of bounding boxes, in gripper openings, from which on a start is not evaluated, though it may be
            refined.
        screened: starts evaluated in one search before any are refined; more where the first grasps are refused.
        budget: evaluations of one `GraspSearch` after which no more are begun.
        refined: starts refined at most in one search; a multiple of `BATCH`.
        max_evaluations: evaluations spent on one refined start, in `OUTER_ROUNDS` rounds of Algorithm 3.
        enough: grasps after which `generate_grasps` stops.
        sharpness: p of all bodies.
    """

    margin: float = 0.06
    depth: float = 0.5
    quality_threshold: float = 1.85
    starts: StartKind = StartKind.CRITICAL
    max_axes: int = 12
    lean: float = 0.0
    angles: int = 12
    deep: float = 0.25
    screened: int = 16
    budget: int = 120
    refined: int = 4
    max_evaluations: int = 8
    enough: int = 8
    sharpness: int = 512


class GraspResult(NamedTuple):
    """Outcome of `generate_grasps`.

    Attributes:
        grasps: feasible grasps, best first (by quality and nearness to the centre of mass); empty if none was found.
        evaluations: evaluated grasps, every member of a batch counted (Table IV's eval-grasp calls).
        reason: why there is none: "too wide", "out of reach", "enclosed" or "poor quality"; "" if there is one.
    """

    grasps: tuple[Grasp, ...]
    evaluations: int
    reason: str
