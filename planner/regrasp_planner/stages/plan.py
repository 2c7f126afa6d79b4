"""What a plan is made of: stages, their segments, and the reason when there is none."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from jaxtyping import Float

from regrasp_planner.errors import StrategyError
from regrasp_planner.grasp.grasp import Grasp
from regrasp_planner.path.trajectory import Trajectory
from regrasp_planner.pose import Pose


class Strategy(StrEnum):
    """How far the planner may go (the paper's ablation, Table II)."""

    DIRECT = "direct"
    """One grasp from pick to place."""
    STATIC = "static"
    """One regrasp where needed; the target is put down in a stable pose."""
    NONSTATIC = "nonstatic"
    """One regrasp where needed; the target may be released tilted, to settle into a stable pose (GraspGen⁺)."""
    REPEATED = "repeated"
    """As many regrasps as needed, up to `PlanOptions.max_stages`."""
    SAMPLING = "sampling"
    """The baseline: one grasp from pick to place, chosen from many random ones."""

    @classmethod
    def _missing_(cls, value: object) -> Strategy:
        raise StrategyError(f"unknown strategy {value!r}; the strategies are {', '.join(cls)}")


class StageKind(StrEnum):
    """What a stage, one grasp, is for."""

    PICK_TO_PLACE = "pick-to-place"
    PICK_TO_RELEASE = "pick-to-release"
    REGRASP_TO_PLACE = "regrasp-to-place"
    REGRASP_TO_RELEASE = "regrasp-to-release"


class SegmentKind(StrEnum):
    """What the robot does during one piece of a stage."""

    TRANSIT = "transit"
    """Move with an empty, open gripper."""
    APPROACH = "approach"
    """Straight line over the target."""
    CLOSE = "close"
    """Close the fingers; the arm stands still."""
    LIFT = "lift"
    """Straight line away from the support, the target held."""
    TRANSFER = "transfer"
    """Move with the target held."""
    LOWER = "lower"
    """Straight line down to the support."""
    OPEN = "open"
    """Open the fingers; the arm stands still."""
    RETREAT = "retreat"
    """Straight line away from the target."""


class Reason(StrEnum):
    """Why there is no plan, or why its execution ended."""

    TOO_WIDE = "too wide"
    """The target is wider than the gripper opens, in every direction."""
    ENCLOSED = "enclosed"
    """No grasp keeps clear of the obstacles around the target in one scene alone."""
    NO_COMMON_GRASP = "no common grasp"
    """No grasp keeps clear of the obstacles of both scenes of a stage together."""
    NO_STABLE_POSE = "no stable pose"
    """No stable pose fits the release area, or none from which the target can be taken on."""
    UNREACHABLE = "unreachable"
    """No configuration of the arm reaches the grasps, clear of collision and within the joint limits."""
    NO_PATH = "no path"
    """Configurations exist but no collision-free path between them was found."""
    SETTLED_ELSEWHERE = "settled elsewhere"
    """During execution: there is no plan from where the released target came to rest."""
    LOST_GRASP = "lost grasp"
    """During execution: the target slipped out of the fingers or was never between them."""
    MISPLACED = "misplaced"
    """During execution: all stages ran, but the target is not at its goal."""
    BAD_INPUT = "bad input"
    """The task itself is not valid."""


@dataclass(frozen=True)
class Failure:
    """Why planning failed.

    Attributes:
        reason: what went wrong.
        stage: the kind of stage that failed ("" if none).
        constraint: the constraint that failed, such as "world collision: link5 – shelf_top".
        message: one sentence for a person, with the fix where there is one.
    """

    reason: Reason
    stage: str
    constraint: str
    message: str

    def __str__(self) -> str:
        where = f" in {self.stage}" if self.stage else ""
        what = f" ({self.constraint})" if self.constraint else ""
        return f"{self.reason}{where}{what}: {self.message}"


@dataclass(frozen=True)
class Segment:
    """One piece of a stage.

    Attributes:
        kind: what happens.
        trajectory: motion of the arm; None where only the fingers move.
        theta: finger coordinate commanded during it; with ``holding`` the fingers press towards it.
        holding: whether the target is held during it.
    """

    kind: SegmentKind
    trajectory: Trajectory | None
    theta: float
    holding: bool


@dataclass(frozen=True)
class Stage:
    """One grasp, from the pick to the release of the target.

    Attributes:
        kind: what the stage is for.
        grasp: the grasp, in the target's frame.
        start_pose: (7,) the target's pose at the pick.
        release_pose: (7,) its pose at the release (g_T^pre).
        settled_pose: (7,) the pose it settles into (g_T^post): for a static release, ``release_pose`` on the ground.
        segments: in the order of execution.
    """

    kind: StageKind
    grasp: Grasp
    start_pose: Pose
    release_pose: Pose
    settled_pose: Pose
    segments: tuple[Segment, ...]

    @property
    def end(self) -> Float[np.ndarray, " n"]:
        """Configuration of the arm at the end, (n,) radians."""
        last = [segment.trajectory for segment in self.segments if segment.trajectory is not None][-1]
        return last.goal


Outcome = tuple[Stage, ...] | Failure
"""Stages that lead to the goal, or why there are none."""


@dataclass(frozen=True)
class Phase:
    """Outcome and cumulative cost once a strategy is exhausted.

    Attributes:
        strategy: the strategy.
        failure: why it has no plan; None if it found one.
        eval_grasp_calls, ordered_starts: as in `PlanStats`, up to then.
        seconds: since planning began.
    """

    strategy: Strategy
    failure: Failure | None
    eval_grasp_calls: int
    ordered_starts: int
    seconds: float


@dataclass(frozen=True)
class PlanStats:
    """What a plan cost.

    Attributes:
        eval_grasp_calls: evaluated grasps, each member of a batch counted (Table IV).
        ordered_starts: start grasps put in order by bounding boxes, which evaluates none of them.
        seconds: wall-clock seconds by module ("grasp_gen", "stab_pose", "ik_solve", "path_plan", "total").
        phases: outcomes of the strategies tried in turn, up to the one that found the plan or was asked for. Each
            strategy contains those before it, so that its phase is what planning by it alone comes to.
    """

    eval_grasp_calls: int = 0
    ordered_starts: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    phases: tuple[Phase, ...] = ()


@dataclass(frozen=True)
class Plan:
    """Outcome of `plan`: the stages, or the reason why there are none.

    Attributes:
        success: whether ``stages`` lead to the goal.
        failure: the reason if not.
        stages: grasps in the order of execution; empty without success.
        strategy: the strategy asked for.
        stats: see `PlanStats`.
        seed: seed of the random starts.
    """

    success: bool
    failure: Failure | None
    stages: tuple[Stage, ...]
    strategy: Strategy
    stats: PlanStats
    seed: int

    @classmethod
    def of(cls, outcome: Outcome, strategy: Strategy, seed: int, stats: PlanStats | None = None) -> Plan:
        """The plan with this outcome."""
        failed = isinstance(outcome, Failure)
        failure, stages = (outcome, ()) if failed else (None, outcome)
        return cls(not failed, failure, stages, strategy, stats or PlanStats(), seed)
