"""Options of `plan`."""

from __future__ import annotations

from dataclasses import dataclass, field

from regrasp_planner.grasp.grasp import GraspGenOptions
from regrasp_planner.grasp.sampling import SamplingOptions
from regrasp_planner.path.options import PathOptions


@dataclass(frozen=True)
class MotionOptions:
    """Lengths and margins of a stage's motion, metres.

    Attributes:
        approach: lengths of the straight line to the target and back, tried in turn.
        lift: heights of the straight line off the support after the pick, tried in turn.
        lower: heights from which the target is lowered onto the support, tried in turn.
        margin_world: clearance between robot and obstacles on the way.
        margin_target: clearance between open gripper and target.
        margin_held: clearance between held target and obstacles on the way.
        drop: height above the support at which the target is released, so that the arm does not press it down.
        solutions: configurations tried at each end of a stage.
        joins: pairs of pick and place motions between which paths are planned.
        path: options of the path planner.
    """

    approach: tuple[float, ...] = (0.10, 0.06, 0.035)
    lift: tuple[float, ...] = (0.08, 0.03)
    lower: tuple[float, ...] = (0.04, 0.015)
    margin_world: float = 0.003
    margin_target: float = 0.0005
    margin_held: float = 0.005
    drop: float = 0.002
    solutions: int = 3
    joins: int = 3
    path: PathOptions = field(default_factory=lambda: PathOptions(contact_tolerance=3e-3, search_rounds=60))


@dataclass(frozen=True)
class PlanOptions:
    """Options of `plan`.

    Attributes:
        grasp: options of GraspGen for one grasp from pick to place.
        regrasp: options of GraspGen for the grasps of a regrasp, on which more depends.
        sampling: options of the sampling baseline.
        motion: options of IkSolve and PathPlan.
        max_stable_poses: stable poses tried for a regrasp, most stable first.
        max_stages: most stages of a plan.
        yaws: turns about the vertical at which the target may be put down.
        release_positions: where in the release area it may be put down; see `resting_poses`.
        motion_attempts: grasps, or poses at rest, whose motion is planned before a pair of scenes is given up.
        grasps_kept: reachable grasps kept for each end of a stage.
        chains: chains of more than two stages whose motion is planned.
    """

    grasp: GraspGenOptions = field(default_factory=GraspGenOptions)
    regrasp: GraspGenOptions = field(default_factory=lambda: GraspGenOptions(screened=32, budget=600))
    sampling: SamplingOptions = field(default_factory=SamplingOptions)
    motion: MotionOptions = field(default_factory=MotionOptions)
    max_stable_poses: int = 14
    max_stages: int = 4
    yaws: int = 8
    release_positions: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    motion_attempts: int = 4
    grasps_kept: int = 4
    chains: int = 8
