"""The pipeline: one grasp from pick to place if there is one, else a regrasp in between (the paper's Fig. 2b)."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from regrasp_planner.errors import StrategyError, TaskError
from regrasp_planner.grasp_gen import Grasp, GraspGenOptions, GraspResult, generate_grasps
from regrasp_planner.pose import Pose
from regrasp_planner.robot import Robot, check_configuration
from regrasp_planner.scene import Scene, Task
from regrasp_planner.stab_pose import StablePoses, stable_poses
from regrasp_planner.stage_motion import (
    Clock,
    Ends,
    MotionOptions,
    Reaches,
    StageMotion,
    Surroundings,
    flipped,
    solve_ends,
)
from regrasp_planner.stages import Failure, Plan, PlanStats, Reason, Stage, StageKind, Strategy


@dataclass(frozen=True)
class PlanOptions:
    """Options of `plan`.

    Attributes:
        grasp: options of GraspGen.
        motion: options of IkSolve and PathPlan.
        max_stable_poses: stable poses tried for the regrasp, most stable first.
        yaws: turns about the vertical at which the target may be put down.
        motion_attempts: grasps, or places to put down, whose motion is planned before giving up on a pair of scenes.
        grasps_kept: grasps that can be reached which are kept for either end of a stage.
    """

    grasp: GraspGenOptions = field(default_factory=GraspGenOptions)
    motion: MotionOptions = field(default_factory=MotionOptions)
    max_stable_poses: int = 8
    yaws: int = 8
    motion_attempts: int = 4
    grasps_kept: int = 4


def plan(
    task: Task,
    robot: Robot,
    strategy: Strategy | str = Strategy.STATIC,
    seed: int = 0,
    options: PlanOptions | None = None,
    known_grasps: Sequence[Grasp] = (),
) -> Plan:
    """Plan the task.

    Args:
        task: what to move, from where to where, among what.
        robot: arm, gripper and their bodies.
        strategy: see `Strategy`; a name does.
        seed: of the random starts; the same seed gives the same plan.
        options: see `PlanOptions`.
        known_grasps: grasps tried for the whole way before any are generated, such as those of an earlier plan.

    Returns:
        `Plan`, with ``failure`` set where there is none.

    Raises:
        StrategyError: unknown strategy.
    """
    names = [str(member) for member in Strategy]
    if strategy not in names:
        raise StrategyError(f"unknown strategy {strategy!r}; the strategies are {', '.join(names)}")
    planner = _Planner(task, robot, Strategy(strategy), seed, options or PlanOptions())
    began = time.perf_counter()
    outcome = planner.run(known_grasps)
    planner.clock.seconds["total"] = time.perf_counter() - began
    stats = PlanStats(planner.eval_grasp_calls, planner.clock.seconds)
    if isinstance(outcome, Failure):
        return Plan(False, outcome, (), planner.strategy, stats, seed)
    return Plan(True, None, outcome, planner.strategy, stats, seed)


@dataclass(frozen=True)
class _Held:
    """A grasp, and the ways to it and on from it with the target at one pose."""

    grasp: Grasp
    reaches: Reaches


class _Planner:
    """One call of `plan`: the task, what it cost so far, and the stages' motion."""

    def __init__(self, task: Task, robot: Robot, strategy: Strategy, seed: int, options: PlanOptions):
        self.task, self.robot, self.strategy, self.seed, self.options = task, robot, strategy, seed, options
        self.clock = Clock()
        self.eval_grasp_calls = 0
        obstacles = task.pick.obstacles
        self.surroundings = Surroundings(robot, task.target, obstacles, options.motion)
        self.motion = StageMotion(self.surroundings, self.clock, seed)

    def run(self, known_grasps: Sequence[Grasp]) -> tuple[Stage, ...] | Failure:
        invalid = self.invalid()
        if invalid is not None:
            return invalid
        task = self.task
        goal = _raised(task.place.target_pose, self.options.motion.drop)
        outcome = self.one_grasp(StageKind.PICK_TO_PLACE, task.pick, task.place, goal, known_grasps)
        if (
            isinstance(outcome, Failure)
            and self.strategy is not Strategy.DIRECT
            and outcome.reason is not Reason.TOO_WIDE
        ):
            return self.static_regrasp(goal)
        return outcome

    def invalid(self) -> Failure | None:
        """The task's first mistake."""
        try:
            check_task(self.task, self.robot)
        except ValueError as error:
            return Failure(Reason.BAD_INPUT, "", "", str(error))
        return None

    # --- one grasp ----------------------------------------------------------------------------------------------------

    def one_grasp(
        self, kind: StageKind, start: Scene, end: Scene, release: Pose, known_grasps: Sequence[Grasp]
    ) -> tuple[Stage, ...] | Failure:
        """A single stage between two scenes."""
        failure: Failure | None = None
        for grasps in self._sources(kind, (start, end), known_grasps):
            if isinstance(grasps, Failure):
                return grasps if failure is None or grasps.reason is Reason.TOO_WIDE else failure
            attempts = 0
            rejected: list[Ends] = []
            for grasp, picks, places in self._reachable_at_both(grasps, start.target_pose, release, rejected):
                takes = self.motion.takes(kind, grasp, start.target_pose, picks)
                puts = self.motion.puts(kind, grasp, release, places)
                stage = self.motion.join(
                    kind, grasp, start.target_pose, release, end.target_pose, takes, puts, self.task.start
                )
                if isinstance(stage, Stage):
                    return (stage,)
                failure = _furthest(failure or stage, stage)
                attempts += bool(takes and puts)
                if attempts == self.options.motion_attempts:
                    break
            failure = failure or self.unreachable(kind, rejected)
        assert failure is not None
        return failure

    def _reachable_at_both(
        self, grasps: Sequence[Grasp], start: Pose, release: Pose, rejected: list[Ends]
    ) -> Iterator[tuple[Grasp, Ends, Ends]]:
        """Grasps with their configurations at either end; ends without any are appended to ``rejected``."""
        picks = self.ends(grasps, start)
        kept = [(grasp, pick) for grasp, pick in zip(grasps, picks, strict=True) if pick.configurations]
        places = self.ends([grasp for grasp, _ in kept], release) if kept else []
        rejected += [end for end in (*picks, *places) if not end.configurations]
        for (grasp, pick), place in zip(kept, places, strict=True):
            if place.configurations:
                yield grasp, pick, place

    def _sources(
        self, kind: StageKind, scenes: Sequence[Scene], known_grasps: Sequence[Grasp]
    ) -> Iterator[Sequence[Grasp] | Failure]:
        if known_grasps:
            yield known_grasps
        yield self.grasps(kind, scenes)

    def grasps(self, kind: StageKind, scenes: Sequence[Scene]) -> Sequence[Grasp] | Failure:
        """GraspGen, each grasp with the fingers either way round."""
        result: GraspResult = self.clock.time(
            "grasp_gen",
            lambda: generate_grasps(self.task.target, scenes, self.robot.gripper, self.options.grasp),
        )
        self.eval_grasp_calls += result.evaluations
        if result.grasps:
            return [g for grasp in result.grasps for g in (grasp, flipped(grasp, self.robot))]
        names = " and ".join(scene.name for scene in scenes)
        name = self.task.target.name
        if result.reason == "too wide":
            opening = float(self.robot.gripper.max_opening)
            message = f"{name!r} is wider in every direction than the gripper opens ({1e3 * opening:.0f} mm)"
            return Failure(Reason.TOO_WIDE, kind, "finger limits", message)
        message = f"no grasp of {name!r} keeps clear of the obstacles of {names} together"
        return Failure(Reason.NO_COMMON_GRASP, kind, f"world collision or {result.reason}", message)

    # --- both ends of a stage -----------------------------------------------------------------------------------------

    def ends(self, grasps: Sequence[Grasp], target_pose: Pose) -> list[Ends]:
        """Configurations for each grasp of the target standing at one pose."""
        home = np.asarray(self.robot.home)
        return self.clock.time("ik_solve", lambda: solve_ends(self.surroundings, grasps, target_pose, home, self.seed))

    def unreachable(self, kind: StageKind, ends: Sequence[Ends] = ()) -> Failure:
        """No configuration at all; the constraint is the one that most of the ``ends`` fail by."""
        name = self.task.target.name
        message = f"no collision-free configuration of the arm reaches the grasps of {name!r} where they are needed"
        # Without the figures, which differ from grasp to grasp.
        constraints = Counter(end.constraint.split(",")[0] for end in ends if end.constraint).most_common(1)
        return Failure(Reason.UNREACHABLE, kind, constraints[0][0] if constraints else "inverse kinematics", message)

    def takes(self, kind: StageKind, grasps: Sequence[Grasp], pose: Pose) -> tuple[list[_Held], Failure]:
        """Those of the grasps by which the target standing at ``pose`` can be taken up, and why the last can not."""
        return self._either_end(kind, grasps, pose, self.motion.takes)

    def puts(self, kind: StageKind, grasps: Sequence[Grasp], pose: Pose) -> tuple[list[_Held], Failure]:
        """Those of the grasps by which the target can be put down at ``pose``, and why the last can not."""
        return self._either_end(kind, grasps, pose, self.motion.puts)

    def _either_end(
        self,
        kind: StageKind,
        grasps: Sequence[Grasp],
        pose: Pose,
        find: Callable[[StageKind, Grasp, Pose, Ends], Reaches],
    ) -> tuple[list[_Held], Failure]:
        ends = self.ends(grasps, pose)
        failure = self.unreachable(kind, ends)
        found: list[_Held] = []
        for grasp, end in zip(grasps, ends, strict=True):
            if not end.configurations:
                continue
            reaches = find(kind, grasp, pose, end)
            if reaches:
                found.append(_Held(grasp, reaches))
                if len(found) == self.options.grasps_kept:
                    break
            else:
                failure = reaches.failure
        return found, failure

    # --- regrasp ------------------------------------------------------------------------------------------------------

    def static_regrasp(self, goal: Pose) -> tuple[Stage, ...] | Failure:
        """Two stages with the target put down in one of its stable poses in between."""
        task, options = self.task, self.options
        poses: StablePoses = self.clock.time(
            "stab_pose", lambda: stable_poses(task.target.hull_vertices(), task.target.center_of_mass)
        )
        failure = Failure(
            Reason.NO_STABLE_POSE,
            StageKind.PICK_TO_RELEASE,
            "stable pose",
            f"{task.target.name!r} rests in no pose that fits the release area",
        )
        for rotation in np.asarray(poses.rotations)[: options.max_stable_poses]:
            settled = self.release_poses(rotation)
            if not settled:
                continue
            scene = Scene("release", settled[0], self.surroundings.obstacles)
            second = self.grasps(StageKind.REGRASP_TO_PLACE, (scene, task.place))
            if isinstance(second, Failure):
                failure = _furthest(failure, second)
                continue
            placing, lacking = self.puts(StageKind.REGRASP_TO_PLACE, second, goal)
            if not placing:
                failure = _furthest(failure, lacking)
                continue
            first = self.grasps(StageKind.PICK_TO_RELEASE, (task.pick, scene))
            if isinstance(first, Failure):
                failure = _furthest(failure, first)
                continue
            picking, lacking = self.takes(StageKind.PICK_TO_RELEASE, first, task.pick.target_pose)
            if not picking:
                failure = _furthest(failure, lacking)
                continue
            outcome = self.over_release(settled, picking, placing, goal)
            if not isinstance(outcome, Failure):
                return outcome
            failure = _furthest(failure, outcome)
        return failure

    def over_release(
        self, settled: Sequence[Pose], picking: Sequence[_Held], placing: Sequence[_Held], goal: Pose
    ) -> tuple[Stage, ...] | Failure:
        """Both stages, with the target put down at the first of the ``settled`` poses where all of it works."""
        task, attempts = self.task, self.options.motion_attempts
        taking = {id(held.grasp): held.reaches for held in picking}
        putting = {id(held.grasp): held.reaches for held in placing}
        failure: Failure | None = None
        tried = 0
        for pose in settled:
            retakes, lacking = self.takes(StageKind.REGRASP_TO_PLACE, [held.grasp for held in placing], pose)
            released = _raised(pose, self.options.motion.drop)
            lays: list[_Held] = []
            if retakes:
                lays, lacking = self.puts(StageKind.PICK_TO_RELEASE, [held.grasp for held in picking], released)
            if not lays:
                failure = _furthest(failure or lacking, lacking)
                continue
            first: Stage | Failure = lacking
            for held in lays:
                pick = task.pick.target_pose
                first = self.motion.join(
                    StageKind.PICK_TO_RELEASE,
                    held.grasp,
                    pick,
                    released,
                    pose,
                    taking[id(held.grasp)],
                    held.reaches,
                    task.start,
                )
                if isinstance(first, Stage):
                    break
            if isinstance(first, Failure):
                failure = _furthest(failure or first, first)
            else:
                for held in retakes:
                    second = self.motion.join(
                        StageKind.REGRASP_TO_PLACE,
                        held.grasp,
                        pose,
                        goal,
                        task.place.target_pose,
                        held.reaches,
                        putting[id(held.grasp)],
                        _end_of(first),
                    )
                    if isinstance(second, Stage):
                        return (first, second)
                    failure = _furthest(failure or second, second)
            tried += 1
            if tried == attempts:
                break
        assert failure is not None
        return failure

    def release_poses(self, rotation: Float[np.ndarray, "3 3"]) -> list[Pose]:
        """Poses in the release area, at several turns about the vertical, in which the target rests on this side."""
        area, hull = self.task.release, self.task.target.hull_vertices()
        poses: list[Pose] = []
        for yaw in np.arange(self.options.yaws) * (2 * np.pi / self.options.yaws):
            turned = Rotation.from_euler("z", yaw) * Rotation.from_matrix(rotation)
            points = turned.apply(hull)
            low, high = points.min(axis=0), points.max(axis=0)
            if (0.5 * (high - low)[:2] > area.half_extents).any():
                continue
            position = np.append(area.center[:2] - 0.5 * (low + high)[:2], area.center[2] - low[2])
            poses.append(np.concatenate([turned.as_quat(scalar_first=True), position]))
        return poses


_PROGRESS = (
    Reason.TOO_WIDE,
    Reason.NO_STABLE_POSE,
    Reason.NO_COMMON_GRASP,
    Reason.UNREACHABLE,
    Reason.NO_PATH,
)


def _furthest(one: Failure, other: Failure) -> Failure:
    """The failure that came later in the pipeline says most about what to change."""
    return max((one, other), key=lambda failure: _PROGRESS.index(failure.reason))


def _raised(pose: Pose, height: float) -> Pose:
    raised = np.array(pose, float)
    raised[6] += height
    return raised


def _end_of(stage: Stage) -> Float[np.ndarray, " n"]:
    trajectory = stage.segments[-1].trajectory
    assert trajectory is not None
    return trajectory.goal


def check_task(task: Task, robot: Robot) -> None:
    """Raise `TaskError` naming the first thing about the task that can not be planned with."""
    named: list[tuple[str, Pose]] = [("pick", task.pick.target_pose), ("place", task.place.target_pose)]
    named += [(obstacle.body.name, obstacle.pose) for obstacle in (*task.pick.obstacles, *task.place.obstacles)]
    for name, pose in named:
        pose = np.asarray(pose, float)
        if pose.shape != (7,) or not np.isfinite(pose).all() or abs(np.linalg.norm(pose[:4]) - 1) > 1e-3:
            raise TaskError(f"pose of {name!r} is {pose}; give (7,) wxyz_xyz with a unit quaternion, in metres")
    scenes = ({id(obstacle) for obstacle in scene.obstacles} for scene in (task.pick, task.place))
    if len(set(map(frozenset, scenes))) > 1:
        raise TaskError("the pick and the place scene differ in their obstacles; give both scenes all of them")
    _check_names(task)
    target = task.target
    if not target.pieces:
        raise TaskError(f"target {target.name!r} has no convex pieces; give it at least one")
    swept = max(float(piece.radius) for piece in target.pieces)
    if swept > 1e-3:
        raise TaskError(
            f"target {target.name!r} is swept by {swept} m (a capsule or sphere); give the vertices of a polyhedron"
        )
    center = np.asarray(target.center_of_mass, float)
    if center.shape != (3,) or not np.isfinite(center).all():
        raise TaskError(f"centre of mass of {target.name!r} is {center}; give (3,) metres")
    area = np.concatenate([task.release.center, task.release.half_extents])
    if area.shape != (5,) or not np.isfinite(area).all() or (np.asarray(task.release.half_extents) <= 0).any():
        raise TaskError(
            f"release area {area} is no rectangle; give a centre (3,) and half extents (2,) above 0, metres"
        )
    try:
        check_configuration(robot, task.start)
    except ValueError as error:
        raise TaskError(f"start: {error}") from error


def _check_names(task: Task) -> None:
    names = [task.target.name, *(obstacle.body.name for obstacle in task.pick.obstacles)]
    reserved = {"", "held", "world", "arm", "gripper", "fingers", "palm", "finger0", "finger1"}
    for name in names:
        if name in reserved or names.count(name) > 1:
            raise TaskError(f"{name!r} names more than one thing; give the target and each obstacle a name of its own")
    unknown = task.supports - set(names)
    if unknown:
        raise TaskError(f"support {sorted(unknown)[0]!r} is not among the obstacles {sorted(names[1:])}")
