"""The motion of one stage: configurations for its grasp at both ends, and the paths that join them.

A stage runs transit – approach – close – lift – transfer – lower – open – retreat. The short straight lines are worked
out first, from the configurations at the grasp outwards, since they fail soonest; the two long paths come last.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from regrasp_planner.collision import IDENTITY, CollisionModel, collision_model
from regrasp_planner.grasp import Grasp
from regrasp_planner.ik_solve import solve_ik
from regrasp_planner.path_plan import PathOptions, PathResult, cartesian_path, plan_path
from regrasp_planner.pose import Pose, rigid, wxyz_xyz
from regrasp_planner.robot import Robot
from regrasp_planner.scene import Body, Obstacle
from regrasp_planner.stages import Failure, Reason, Segment, SegmentKind, Stage, StageKind
from regrasp_planner.trajectory import Trajectory

T = TypeVar("T")


@dataclass(frozen=True)
class MotionOptions:
    """Lengths and margins of a stage's motion, metres.

    Attributes:
        approach: lengths of the straight line over the target and back, tried in turn.
        lift: heights of the straight line off the support after taking the target, tried in turn.
        lower: heights from which the target is lowered onto the support, tried in turn.
        margin_world: clearance of the robot from obstacles on the way.
        margin_target: clearance of the open gripper from the target.
        margin_held: clearance of the held target from obstacles on the way.
        drop: height above the support at which the target is let go, so that the arm does not press it down.
        solutions: configurations tried at each end of a stage.
        joins: pairs of ways to either end between which paths are planned.
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


@dataclass
class Clock:
    """Wall-clock seconds by module."""

    seconds: dict[str, float] = field(default_factory=dict)

    def time(self, module: str, call: Callable[[], T]) -> T:
        """Result of ``call()``, its duration added to the module's."""
        began = time.perf_counter()
        try:
            return call()
        finally:
            self.seconds[module] = self.seconds.get(module, 0.0) + time.perf_counter() - began


def flipped(grasp: Grasp, robot: Robot) -> Grasp:
    """The same grasp with the gripper turned half round about its approach axis: the fingers change places."""
    axis = np.asarray(robot.gripper.approach_axis)
    turn = np.concatenate([[0.0], axis, np.zeros(3)])
    pose = wxyz_xyz(rigid(grasp.pose) * rigid(turn))
    return Grasp(pose, grasp.theta, grasp.opening, grasp.quality, grasp.clearance)


class Surroundings:
    """The task's obstacles and the target at a given pose, as collision models for an empty or a full hand."""

    def __init__(self, robot: Robot, target: Body, obstacles: Sequence[Obstacle], options: MotionOptions):
        self.robot, self.target, self.options = robot, target, options
        self.obstacles = tuple(obstacles)
        self._models: dict[tuple[str, bytes], CollisionModel] = {}

    def empty_handed(self, target_pose: Pose) -> CollisionModel:
        """The target is one more obstacle, which the gripper may come close to."""
        name = self.target.name
        key = (name, np.asarray(target_pose, float).tobytes())
        if key not in self._models:
            self._models[key] = self._empty.moved(name, target_pose)
        return self._models[key]

    def holding(self, grasp: Grasp) -> CollisionModel:
        """The target moves with the gripper."""
        key = ("held", grasp.pose.tobytes())
        if key not in self._models:
            self._models[key] = self._full.moved("held", wxyz_xyz(rigid(grasp.pose).inv()))
        return self._models[key]

    @cached_property
    def arm_alone(self) -> CollisionModel:
        """The arm without its gripper among the obstacles."""
        return collision_model(
            self.robot,
            self.obstacles,
            margin_world=self.options.margin_world,
            overrides={("gripper", "world"): None},
        )

    @cached_property
    def _empty(self) -> CollisionModel:
        return collision_model(
            self.robot,
            (*self.obstacles, Obstacle(self.target, IDENTITY)),
            margin_world=self.options.margin_world,
            overrides={("gripper", self.target.name): self.options.margin_target},
        )

    @cached_property
    def _full(self) -> CollisionModel:
        return collision_model(
            self.robot,
            self.obstacles,
            held=self.target.pieces,
            margin_world=self.options.margin_world,
            margin_held=self.options.margin_held,
        )


@dataclass(frozen=True)
class Ends:
    """Configurations that put the gripper on the target at one end of a stage, best first; or why there are none."""

    configurations: tuple[Float[np.ndarray, " n"], ...]
    constraint: str


def solve_ends(
    surroundings: Surroundings,
    grasps: Sequence[Grasp],
    target_pose: Pose,
    reference: Float[np.ndarray, " n"],
    seed: int,
) -> list[Ends]:
    """IkSolve for several grasps of the target standing at one pose, in one batch.

    Args:
        surroundings: the obstacles.
        grasps: K grasps.
        target_pose: (7,) where the target stands, in the world.
        reference: (n,) configuration to stay near, radians.
        seed: of the random starts.
    """
    model = surroundings.empty_handed(target_pose)
    targets = np.array([grasp.gripper_pose(target_pose) for grasp in grasps])
    openings = np.array([grasp.opening for grasp in grasps])
    results = solve_ik(
        model, targets, openings, reference=reference, max_solutions=surroundings.options.solutions, seed=seed
    )
    return [Ends(tuple(solution.q for solution in result.solutions), result.message) for result in results]


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

    def __init__(self, surroundings: Surroundings, clock: Clock, seed: int):
        self.surroundings, self.clock, self.seed = surroundings, clock, seed
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
        result: PathResult | None = None
        for displacement in displacements:
            result = self.clock.time(
                "path_plan", lambda d=displacement: cartesian_path(model, q, d, theta, self.options.path)
            )
            if result.trajectory is not None:
                return result.trajectory
        assert result is not None
        return result

    def path(
        self, model: CollisionModel, start: Float[np.ndarray, " n"], goal: Float[np.ndarray, " n"], theta: float
    ) -> PathResult:
        """A path between two configurations at finger coordinate ``theta``, its time taken down."""
        return self.clock.time("path_plan", lambda: plan_path(model, start, goal, theta, self.options.path, self.seed))


def _unreachable(kind: StageKind, ends: Ends) -> Failure:
    return Failure(Reason.UNREACHABLE, kind, ends.constraint, "no configuration of the arm at the grasp")


def no_path(stage: StageKind, segment: SegmentKind, result: PathResult) -> Failure:
    """Why a segment has no path: the bodies in the way, if any."""
    bodies = " – ".join(result.bodies) if result.bodies else result.status.value
    return Failure(Reason.NO_PATH, stage, f"{segment}: {bodies}", result.message)
