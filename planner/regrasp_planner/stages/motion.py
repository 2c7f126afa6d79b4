"""The motion of one stage: straight lines to and from its grasp at both ends, and the paths that connect them.

A stage runs transit – approach – close – lift – transfer – lower – open – retreat. The short straight lines are planned
first, from the configurations at the grasp outwards, since they fail soonest; the two long paths come last.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, product
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from regrasp_planner.collision.model import CollisionModel
from regrasp_planner.path.path_plan import PathResult, cartesian_path, plan_path
from regrasp_planner.path.query import LineQuery, PathQuery
from regrasp_planner.path.space import ConfigurationSpace
from regrasp_planner.path.trajectory import Trajectory
from regrasp_planner.pose import Pose, rigid
from regrasp_planner.stages.clock import Clock
from regrasp_planner.stages.collision_models import CollisionModels
from regrasp_planner.stages.failures import no_path, unreachable
from regrasp_planner.stages.grasp_ik import GraspIk
from regrasp_planner.stages.plan import Failure, Segment, SegmentKind, Stage, StageKind


class PathObserver(Protocol):
    """Told of every query of PathPlan and its result. Lengths are at the planner's scale (`stages.scale`)."""

    def on_path(self, query: PathQuery, result: PathResult) -> None:
        """Called after each `plan_path`."""
        ...

    def on_line(self, query: LineQuery, result: PathResult) -> None:
        """Called after each `cartesian_path`."""
        ...


@dataclass(frozen=True)
class ApproachDepart:
    """Straight lines to a grasp and away from it, at one end of a stage.

    Attributes:
        approach: the line to the grasp: the empty gripper's approach, or the held target's lowering.
        depart: the line away from it: the held target's lift, or the empty gripper's retreat.
        opening: finger coordinate of the empty gripper on its line.
    """

    approach: Trajectory
    depart: Trajectory
    opening: float


class LazyMotions:
    """Motions at one end of a stage, best first, each planned only when it is asked for.

    Args:
        ik: grasp, pose of the target, and configurations.
        attempts: plans a motion from each configuration; a failure where there is none.
        failure: the failure if there are no attempts.

    Attributes:
        failure: of the last attempt that failed.
    """

    def __init__(self, ik: GraspIk, attempts: Iterator[ApproachDepart | Failure], failure: Failure):
        self.ik, self.failure = ik, failure
        self._attempts, self._planned = attempts, list[ApproachDepart]()

    def __iter__(self) -> Iterator[ApproachDepart]:
        k = 0
        while k < len(self._planned) or self._plan_next():
            yield self._planned[k]
            k += 1

    def any_feasible(self) -> bool:
        """Whether there is a motion; plans until one is found."""
        return bool(self._planned) or self._plan_next()

    def _plan_next(self) -> bool:
        for attempt in self._attempts:
            if isinstance(attempt, ApproachDepart):
                self._planned.append(attempt)
                return True
            self.failure = attempt
        return False


class _Lines(NamedTuple):
    """From one configuration at the grasp: the empty gripper off the target, and the held target off the support."""

    withdraw: Trajectory
    opening: float
    lift: Trajectory

    def pick(self) -> ApproachDepart:
        """To the target with the empty gripper, and up with the target."""
        return ApproachDepart(self.withdraw.reversed(), self.lift, self.opening)

    def place(self) -> ApproachDepart:
        """Down with the target, and off it with the empty gripper."""
        return ApproachDepart(self.lift.reversed(), self.withdraw, self.opening)


class StageMotion:
    """Plans the motion of stages.

    Args:
        models: collision models of the task.
        clock: counts the time of PathPlan.
        seed: seed of PathPlan.
        observer: told of every path query.
    """

    def __init__(self, models: CollisionModels, clock: Clock, seed: int, observer: PathObserver | None = None):
        self.models, self.clock, self.seed, self.observer = models, clock, seed, observer
        self.options, self._gripper = models.options, models.robot.gripper

    def pick_motions(self, kind: StageKind, ik: GraspIk) -> LazyMotions:
        """Approach and lift at the pick."""
        tried = self._lines(kind, ik, (ik.grasp.opening,), self.options.lift, (SegmentKind.APPROACH, SegmentKind.LIFT))
        return self._motions(kind, ik, tried, _Lines.pick)

    def place_motions(self, kind: StageKind, ik: GraspIk, wide: bool = False) -> LazyMotions:
        """Lowering and retreat at the release; ``wide``: with the fingers opened all the way if there is room."""
        openings = (float(self._gripper.upper), ik.grasp.opening) if wide else (ik.grasp.opening,)
        tried = self._lines(kind, ik, openings, self.options.lower, (SegmentKind.RETREAT, SegmentKind.LOWER))
        return self._motions(kind, ik, tried, _Lines.place)

    def _motions(
        self,
        kind: StageKind,
        ik: GraspIk,
        tried: Iterator[_Lines | Failure],
        motion: Callable[[_Lines], ApproachDepart],
    ) -> LazyMotions:
        motions = (lines if isinstance(lines, Failure) else motion(lines) for lines in tried)
        return LazyMotions(ik, motions, unreachable(self.models.target, kind, [ik]))

    def connect(
        self,
        kind: StageKind,
        pick: LazyMotions,
        place: LazyMotions,
        settled_pose: Pose,
        start: Float[np.ndarray, " n"],
    ) -> Stage | Failure:
        """The stage from a pick to a place, or why there is none.

        Args:
            kind: what the stage is for.
            pick, place: motions at either end, of the same grasp.
            settled_pose: (7,) of the target at rest after the release.
            start: (n,) configuration of the arm before, with an open gripper, radians.
        """
        for end in (pick, place):
            if not end.any_feasible():
                return end.failure
        grasp, failure = pick.ik.grasp, pick.failure
        holding, closed = self.models.holding(grasp), float(self._gripper.lower)
        pairs = ((one, other) for one in pick for other in place)
        for picking, placing in islice(pairs, self.options.joins):
            transfer = self._path(holding, picking.depart.goal, placing.approach.start, grasp.theta)
            if transfer.trajectory is None:
                failure = no_path(kind, SegmentKind.TRANSFER, transfer)
                continue
            picked = self.pick_segments(kind, pick.ik, picking, start)
            if isinstance(picked, Failure):
                failure = picked
                continue
            segments = (
                *picked,
                Segment(SegmentKind.TRANSFER, transfer.trajectory, closed, holding=True),
                Segment(SegmentKind.LOWER, placing.approach, closed, holding=True),
                Segment(SegmentKind.OPEN, None, placing.opening, holding=False),
                Segment(SegmentKind.RETREAT, placing.depart, placing.opening, holding=False),
            )
            return Stage(kind, grasp, pick.ik.target_pose, place.ik.target_pose, settled_pose, segments)
        return failure

    def pick_segments(
        self, kind: StageKind, ik: GraspIk, motion: ApproachDepart, start: Float[np.ndarray, " n"]
    ) -> tuple[Segment, ...] | Failure:
        """Transit from ``start``, approach, close and lift; or why there is no transit."""
        opening, closed = ik.grasp.opening, float(self._gripper.lower)
        transit = self._path(self.models.empty_handed(ik.target_pose), start, motion.approach.start, opening)
        if transit.trajectory is None:
            return no_path(kind, SegmentKind.TRANSIT, transit)
        return (
            Segment(SegmentKind.TRANSIT, transit.trajectory, opening, holding=False),
            Segment(SegmentKind.APPROACH, motion.approach, opening, holding=False),
            Segment(SegmentKind.CLOSE, None, closed, holding=True),
            Segment(SegmentKind.LIFT, motion.depart, closed, holding=True),
        )

    def _lines(
        self,
        kind: StageKind,
        ik: GraspIk,
        openings: Sequence[float],
        heights: Sequence[float],
        names: tuple[SegmentKind, SegmentKind],
    ) -> Iterator[_Lines | Failure]:
        """The lines from each configuration, at the first opening that works.

        Args:
            kind: what the stage is for.
            ik: grasp, pose of the target, and configurations.
            openings: finger coordinates of the empty gripper, tried in turn.
            heights: of the held target's line, tried in turn, metres.
            names: of the empty gripper's and the held target's line, for failures.
        """
        empty = [ConfigurationSpace(self.models.empty_handed(ik.target_pose), opening) for opening in openings]
        holding = ConfigurationSpace(self.models.holding(ik.grasp), ik.grasp.theta)
        withdrawals = self._withdrawals(ik.grasp.gripper_pose(ik.target_pose))
        lifts = [np.array([0.0, 0.0, height]) for height in heights]
        for q in ik.configurations:
            withdraw, opening = self._line(q, product(empty, withdrawals))
            if withdraw.trajectory is None:
                yield no_path(kind, names[0], withdraw)
                continue
            lift, _ = self._line(q, product((holding,), lifts))
            if lift.trajectory is None:
                yield no_path(kind, names[1], lift)
                continue
            yield _Lines(withdraw.trajectory, opening, lift.trajectory)

    def _withdrawals(self, gripper_pose: Pose) -> list[Float[np.ndarray, " 3"]]:
        """Displacements that take the open gripper off the target: back along the approach axis, levelly, to the base.

        All lie in the plane of the fingers' faces, so that the pads slide off the target.
        """
        pose = rigid(gripper_pose)
        out = -pose.rotation.apply(np.asarray(self._gripper.approach_axis))
        closing = pose.rotation.apply(np.asarray(self._gripper.width_axis))
        home = np.asarray(self.models.robot.arm.base)[4:] - pose.translation
        directions = [out]
        for way in (out * [1.0, 1.0, 0.0], (home - (home @ closing) * closing) * [1.0, 1.0, 0.0]):
            size = float(np.linalg.norm(way))
            unit = way / max(size, 1e-9)
            if unit @ out > 0.3 and all(unit @ other < 0.98 for other in directions):
                directions.append(unit)
        return [length * direction for length in self.options.approach for direction in directions]

    def _line(
        self, q: Float[np.ndarray, " n"], tries: Iterable[tuple[ConfigurationSpace, Float[np.ndarray, " 3"]]]
    ) -> tuple[PathResult, float]:
        """The first straight line from q that works, otherwise the last that did not; and its finger coordinate.

        Args:
            q: (n,) radians.
            tries: spaces and displacements (3,) in metres, at least one.
        """
        result: PathResult | None = None
        theta = 0.0
        for space, displacement in tries:
            theta = space.theta
            query = LineQuery(space, q, displacement, self.options.path)
            with self.clock("path_plan"):
                result = cartesian_path(query)
            if self.observer is not None:
                self.observer.on_line(query, result)
            if result.trajectory is not None:
                break
        assert result is not None
        return result, theta

    def _path(
        self, model: CollisionModel, start: Float[np.ndarray, " n"], goal: Float[np.ndarray, " n"], theta: float
    ) -> PathResult:
        """A path between two configurations at finger coordinate ``theta``."""
        query = PathQuery(ConfigurationSpace(model, theta), start, goal, self.options.path)
        with self.clock("path_plan"):
            result = plan_path(query, self.seed)
        if self.observer is not None:
            self.observer.on_path(query, result)
        return result
