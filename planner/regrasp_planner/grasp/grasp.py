"""Grasps, the options of GraspGen, and its results."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from regrasp_planner.pose import Pose, rigid, wxyz_xyz


@dataclass(frozen=True)
class Grasp:
    """A grasp X = (g_G, θ_G) of the target.

    Attributes:
        pose: (7,) gripper frame in the frame of the target.
        theta: finger coordinate at which both pads touch, in the gripper's unit.
        opening: finger coordinate of the open gripper around the target.
        quality: f = f_anti + f_align, at most 2.
        clearance: least signed distance between the open gripper and the obstacles of all scenes, and between its palm
            and the target, metres.
    """

    pose: Pose
    theta: float
    opening: float
    quality: float
    clearance: float

    def gripper_pose(self, target_pose: Pose) -> Pose:
        """Pose of the gripper (7,) in the world when the target is at ``target_pose``."""
        return wxyz_xyz(rigid(target_pose) * rigid(self.pose))


@dataclass(frozen=True)
class FeasibleGrasp:
    """A feasible grasp, and the direction in the target's frame that points down at its release.

    Attributes:
        grasp: the grasp.
        release: (3,) unit direction; None for a search without a ground at the release.
    """

    grasp: Grasp
    release: Float[np.ndarray, " 3"] | None


class StartKind(StrEnum):
    """Where GraspGen starts."""

    CRITICAL = "critical"
    """Critical directions of the width function, sorted by a broad phase; see `grasp_starts`."""
    UNIFORM = "uniform"
    """The paper's plain multi-start: random gripper poses about the target, all of them refined."""


class NoGraspReason(StrEnum):
    """Why a search found no grasp."""

    TOO_WIDE = "too wide"
    """The target is wider in every direction than the gripper opens."""
    OUT_OF_REACH = "out of reach"
    """The arm reaches none of the initial grasps."""
    ENCLOSED = "enclosed"
    """No evaluated grasp is free of collision."""
    POOR_QUALITY = "poor quality"
    """Every collision-free grasp is below the quality threshold."""


@dataclass(frozen=True)
class GraspGenOptions:
    """Options of `GraspSearch` and `generate_grasps`.

    Attributes:
        margin: collision margin δ_col between the open gripper and obstacles, as a share of the gripper's opening, so
            that one value suits grippers of any size (0.06 is 5 mm for an 80 mm gripper).
        depth: least depth of the grasp centre in the target, as a share of the fingers' length beyond that centre.
        quality_threshold: f_threshold of eq. (1).
        starts: where to start.
        max_axes: most closing axes taken from the width function.
        lean: largest angle between a closing axis and the line between its contacts, radians; 0 takes the minima of
            the width function alone.
        angles: approach angles about each axis; twice as many if there are few axes.
        deep: overlap of bounding boxes, in gripper openings, above which a start is not evaluated; it may still be
            refined.
        screened: starts evaluated in one search before any is refined; more if the first grasps are refused.
        budget: a `GraspSearch` begins no evaluation after this many.
        refined: most starts refined in one search; a multiple of `BATCH`.
        max_evaluations: evaluations spent on one refined start, shared by the `OUTER_ROUNDS` of Algorithm 3.
        enough: `generate_grasps` stops at this many grasps.
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
        grasps: feasible grasps, best first by quality and distance from the centre of mass.
        evaluations: number of evaluated grasps (Table IV's eval-grasp calls); each member of a batch counts.
        reason: why there is no grasp; None if there is one.
    """

    grasps: tuple[Grasp, ...]
    evaluations: int
    reason: NoGraspReason | None
