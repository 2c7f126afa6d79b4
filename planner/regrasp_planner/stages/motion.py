"""The motion of one stage: configurations for its grasp at both ends, and the paths that join them.

A stage runs transit – approach – close – lift – transfer – lower – open – retreat. The short straight lines are worked
out first, from the configurations at the grasp outwards, since they fail soonest; the two long paths come last.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Protocol

import numpy as np
from jaxtyping import Float

from regrasp_planner.collision.model import CollisionModel
from regrasp_planner.grasp.grasp import Grasp
from regrasp_planner.path.options import PathOptions
from regrasp_planner.path.path_plan import PathResult, cartesian_path, plan_path
from regrasp_planner.path.space import ConfigurationSpace
from regrasp_planner.path.trajectory import Trajectory
from regrasp_planner.pose import Pose, rigid
from regrasp_planner.stages.plan import Failure, Reason, Segment, SegmentKind, Stage, StageKind
from regrasp_planner.stages.surroundings import Clock, Ends, Surroundings


class PathObserver(Protocol):
    """Told of every query of PathPlan and its result. Lengths are at the planner's scale (`stages.scale`)."""

    def on_path(
        self,
        space: ConfigurationSpace,
        start: Float[np.ndarray, " n"],
        goal: Float[np.ndarray, " n"],
        options: PathOptions,
        result: PathResult,
    ) -> None:
        """After `plan_path`, with its arguments."""
        ...

    def on_line(
        self,
        space: ConfigurationSpace,
        start: Float[np.ndarray, " n"],
        displacement: Float[np.ndarray, " 3"],
        options: PathOptions,
        result: PathResult,
    ) -> None:
        """After `cartesian_path`, with its arguments."""
        ...


@dataclass(frozen=True)
class Reach:
    """A way to a grasp and on from it, by straight lines: what is possible at one end of a stage.

    Attributes:
        inward: the line to the grasp (approach, or lowering the held target).
        outward: the line away from it (lift, or retreat).
        opening: finger coordinate of the open gripper on its line.
    """

    inward: Trajectory
    outward: Trajectory
    opening: float


class Reaches:
    """The ways at one end of a stage, best first, each worked out only when it is asked for; true if there is one.

    Args:
        attempts: ways, and failures where a configuration has none.
        failure: why there is none if there are no attempts.

    Attributes:
        failure: what the last attempt failed by.
    """

    def __init__(self, attempts: Iterator[Reach | Failure], failure: Failure):
        self._attempts, self._found = attempts, list[Reach]()
        self.failure = failure

    def __iter__(self) -> Iterator[Reach]:
        k = 0
        while k < len(self._found) or self._advance():
            yield self._found[k]
            k += 1

    def __bool__(self) -> bool:
        return bool(self._found) or self._advance()

    def _advance(self) -> bool:
        for attempt in self._attempts:
            if isinstance(attempt, Reach):
                self._found.append(attempt)
                return True
            self.failure = attempt
        return False


class StageMotion:
    """Finds the motion of stages. What was found out about one end of a stage is kept for the next call."""

    def __init__(self, surroundings: Surroundings, clock: Clock, seed: int, observer: PathObserver | None = None):
        self.surroundings, self.clock, self.seed, self.observer = surroundings, clock, seed, observer
        self.options = surroundings.options
        self._axis = np.asarray(surroundings.robot.gripper.approach_axis)

    def takes(self, kind: StageKind, grasp: Grasp, pose: Pose, ends: Ends) -> Reaches:
        """Approach and lift, for the target standing at ``pose``."""
        names = SegmentKind.APPROACH, SegmentKind.LIFT
        lines = self._lines_from(kind, grasp, pose, ends, self.options.lift, names, (grasp.opening,))
        ways = (line if isinstance(line, Failure) else Reach(line[0].reversed(), *line[1:]) for line in lines)
        return Reaches(ways, _unreachable(kind, ends))

    def puts(self, kind: StageKind, grasp: Grasp, pose: Pose, ends: Ends, wide: bool = False) -> Reaches:
        """Lowering and retreat, for the target let go at ``pose``; with fingers opened ``wide`` if they can be."""
        names = SegmentKind.RETREAT, SegmentKind.LOWER
        upper = float(self.surroundings.robot.gripper.upper)
        openings = (upper, grasp.opening) if wide else (grasp.opening,)
        lines = self._lines_from(kind, grasp, pose, ends, self.options.lower, names, openings)
        ways = (line if isinstance(line, Failure) else Reach(line[1].reversed(), line[0], line[2]) for line in lines)
        return Reaches(ways, _unreachable(kind, ends))

    def _lines_from(
        self,
        kind: StageKind,
        grasp: Grasp,
        pose: Pose,
        ends: Ends,
        heights: Sequence[float],
        names: tuple[SegmentKind, SegmentKind],
        openings: Sequence[float],
    ) -> Iterator[tuple[Trajectory, Trajectory, float] | Failure]:
        """From each configuration at the grasp: the empty gripper's line off the target, and the full one's line up.

        With them comes the first of the ``openings`` at which the empty gripper's line works.
        """
        empty, holding = self.surroundings.empty_handed(pose), self.surroundings.holding(grasp)
        back = self._withdrawals(grasp.gripper_pose(pose))
        raises = [np.array([0.0, 0.0, height]) for height in heights]
        for q in ends.configurations:
            opening, *others = openings
            off = self._line(empty, q, back, opening)
            while not isinstance(off, Trajectory) and others:
                opening, *others = others
                off = self._line(empty, q, back, opening)
            if not isinstance(off, Trajectory):
                yield no_path(kind, names[0], off)
                continue
            up = self._line(holding, q, raises, grasp.theta)
            if not isinstance(up, Trajectory):
                yield no_path(kind, names[1], up)
                continue
            yield off, up, opening

    def join(
        self,
        kind: StageKind,
        grasp: Grasp,
        start_pose: Pose,
        release_pose: Pose,
        settled_pose: Pose,
        takes: Reaches,
        puts: Reaches,
        configuration: Float[np.ndarray, " n"],
    ) -> Stage | Failure:
        """The stage between two ends, starting from ``configuration`` with an open gripper; or why there is none.

        Args:
            kind: what the stage is for.
            grasp: the grasp held.
            start_pose, release_pose, settled_pose: (7,) pose of the target when taken, let go, and at rest after that.
            takes, puts: the ways at either end.
            configuration: (n,) where the arm is before, radians.
        """
        if not takes or not puts:
            return (puts if takes else takes).failure
        last = takes.failure
        empty, holding = self.surroundings.empty_handed(start_pose), self.surroundings.holding(grasp)
        closed = float(self.surroundings.robot.gripper.lower)
        pairs = ((take, put) for take in takes for put in puts)
        for take, put in islice(pairs, self.options.joins):
            transfer = self.path(holding, take.outward.goal, put.inward.start, grasp.theta)
            if transfer.trajectory is None:
                last = no_path(kind, SegmentKind.TRANSFER, transfer)
                continue
            transit = self.path(empty, configuration, take.inward.start, grasp.opening)
            if transit.trajectory is None:
                last = no_path(kind, SegmentKind.TRANSIT, transit)
                continue
            segments = (
                Segment(SegmentKind.TRANSIT, transit.trajectory, grasp.opening, holding=False),
                Segment(SegmentKind.APPROACH, take.inward, grasp.opening, holding=False),
                Segment(SegmentKind.CLOSE, None, closed, holding=True),
                Segment(SegmentKind.LIFT, take.outward, closed, holding=True),
                Segment(SegmentKind.TRANSFER, transfer.trajectory, closed, holding=True),
                Segment(SegmentKind.LOWER, put.inward, closed, holding=True),
                Segment(SegmentKind.OPEN, None, put.opening, holding=False),
                Segment(SegmentKind.RETREAT, put.outward, put.opening, holding=False),
            )
            return Stage(kind, grasp, start_pose, release_pose, settled_pose, segments)
        return last

    def _withdrawals(self, gripper_pose: Pose) -> list[Float[np.ndarray, " 3"]]:
        """Displacements that take the open gripper off the target: back along the approach axis, levelly, to the base.

        All lie in the plane of the fingers' faces, so that the pads slide off the target.
        """
        robot, pose = self.surroundings.robot, rigid(gripper_pose)
        out = -pose.rotation.apply(self._axis)
        closing = pose.rotation.apply(np.asarray(robot.gripper.width_axis))
        home = np.asarray(robot.arm.base)[4:] - pose.translation
        directions = [out]
        for way in (out * [1.0, 1.0, 0.0], (home - (home @ closing) * closing) * [1.0, 1.0, 0.0]):
            size = float(np.linalg.norm(way))
            unit = way / max(size, 1e-9)
            if unit @ out > 0.3 and all(unit @ other < 0.98 for other in directions):
                directions.append(unit)
        return [length * direction for length in self.options.approach for direction in directions]

    def _line(
        self,
        model: CollisionModel,
        q: Float[np.ndarray, " n"],
        displacements: Sequence[Float[np.ndarray, " 3"]],
        theta: float,
    ) -> Trajectory | PathResult:
        """The first straight line from q that works, or why the last did not."""
        space = ConfigurationSpace(model, theta)
        result: PathResult | None = None
        for displacement in displacements:
            result = self.clock.time("path_plan", lambda d=displacement: cartesian_path(space, q, d, self.options.path))
            if self.observer is not None:
                self.observer.on_line(space, q, displacement, self.options.path, result)
            if result.trajectory is not None:
                return result.trajectory
        assert result is not None
        return result

    def path(
        self, model: CollisionModel, start: Float[np.ndarray, " n"], goal: Float[np.ndarray, " n"], theta: float
    ) -> PathResult:
        """A path between two configurations at finger coordinate ``theta``, its time taken down."""
        space, options = ConfigurationSpace(model, theta), self.options.path
        result = self.clock.time("path_plan", lambda: plan_path(space, start, goal, options, self.seed))
        if self.observer is not None:
            self.observer.on_path(space, start, goal, options, result)
        return result


def _unreachable(kind: StageKind, ends: Ends) -> Failure:
    return Failure(Reason.UNREACHABLE, kind, ends.constraint, "no configuration of the arm at the grasp")


def no_path(stage: StageKind, segment: SegmentKind, result: PathResult) -> Failure:
    """Why a segment has no path: the bodies in the way, if any."""
    bodies = " – ".join(result.bodies) if result.bodies else result.status.value
    return Failure(Reason.NO_PATH, stage, f"{segment}: {bodies}", result.message)
