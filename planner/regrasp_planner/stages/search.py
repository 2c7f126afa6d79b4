"""The search for one stage: grasps that can be reached where they are needed, and the motion between the ends."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from jaxtyping import Float, Int

from regrasp_planner.grasp.grasp import Grasp, GraspGenOptions
from regrasp_planner.grasp.grasp_gen import Found, GraspSearch
from regrasp_planner.grasp.sampling import SamplingOptions
from regrasp_planner.ik.ik_solve import Reachability, within_reach
from regrasp_planner.pose import Pose, rigid, wxyz_xyz
from regrasp_planner.robot.model import Robot
from regrasp_planner.stages.motion import PathObserver, Reaches, StageMotion
from regrasp_planner.stages.plan import Failure, Reason, Stage, StageKind
from regrasp_planner.stages.surroundings import Clock, Ends, MotionOptions, Surroundings, flipped, solve_ends
from regrasp_planner.task import Scene, Task


@dataclass(frozen=True)
class PlanOptions:
    """Options of `plan`.

    Attributes:
        grasp: options of GraspGen for one grasp from pick to place.
        regrasp: options of GraspGen for the grasps of a regrasp, on which more depends.
        sampling: options of the sampling baseline.
        motion: options of IkSolve and PathPlan.
        max_stable_poses: stable poses tried for a regrasp, most stable first.
        max_stages: stages of a plan at most.
        yaws: turns about the vertical at which the target may be put down.
        spots: where in the release area it may be put down; see `resting_poses`.
        motion_attempts: grasps, or places to put down, whose motion is planned before giving up on a pair of scenes.
        grasps_kept: grasps that can be reached which are kept for either end of a stage.
        chains: chains of more than two stages whose motion is planned.
    """

    grasp: GraspGenOptions = field(default_factory=GraspGenOptions)
    regrasp: GraspGenOptions = field(default_factory=lambda: GraspGenOptions(screened=32, budget=600))
    sampling: SamplingOptions = field(default_factory=SamplingOptions)
    motion: MotionOptions = field(default_factory=MotionOptions)
    max_stable_poses: int = 14
    max_stages: int = 4
    yaws: int = 8
    spots: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    motion_attempts: int = 4
    grasps_kept: int = 4
    chains: int = 8


@dataclass(frozen=True)
class Held:
    """A grasp, the direction in the target's frame that points down when it lets go, and ways to it at one end."""

    grasp: Grasp
    down: Float[np.ndarray, " 3"] | None
    reaches: Reaches | None


class StageSearch:
    """What the stages of one task have in common.

    Args:
        task: the task.
        robot: arm, gripper and their bodies.
        seed: of the random starts.
        options: see `PlanOptions`.
        observer: told of every path query.

    Attributes:
        clock: seconds spent by module.
        goal: (7,) pose in which the target is let go at its goal, a little above it.
        searches: all grasp searches made.
        sampled: grasps evaluated by the sampling baseline.
    """

    def __init__(
        self, task: Task, robot: Robot, seed: int, options: PlanOptions, observer: PathObserver | None = None
    ) -> None:
        self.task, self.robot, self.seed, self.options = task, robot, seed, options
        self.clock = Clock()
        self.surroundings = Surroundings(robot, task.target, task.pick.obstacles, options.motion)
        self.motion = StageMotion(self.surroundings, self.clock, seed, observer)
        self.searches: list[GraspSearch] = []
        self.sampled = 0
        self._looked: dict[tuple[bytes, bool], dict[bytes, int]] = {}
        self.goal = np.array(task.place.target_pose, float)
        self.goal[6] += options.motion.drop

    def search(self, options: GraspGenOptions, *scenes: Scene) -> GraspSearch:
        """A search for grasps that are feasible in all the scenes and that the arm reaches there, obstacles aside."""

        def reachable(grippers: Float[np.ndarray, "K 7"]) -> Int[np.ndarray, " K"]:
            grades = np.full(len(grippers), int(Reachability.FREE))
            for scene in scenes:
                left = np.flatnonzero(grades)
                grades[left] = np.minimum(grades[left], self.looked(scene.target_pose, grippers[left]))
            return grades

        made = GraspSearch(
            self.task.target, scenes, self.robot.gripper, options, reachable if scenes else None, self.seed
        )
        self.searches.append(made)
        return made

    def looked(
        self, target_pose: Pose, grippers: Float[np.ndarray, "K 7"], collisions: bool = True
    ) -> Int[np.ndarray, " K"]:
        """How well the arm alone takes grasps, (K, 7) in the target's frame, of the target standing at a pose.

        Searches share their starts, so that each is looked at once.
        """
        known = self._looked.setdefault((np.asarray(target_pose, float).tobytes(), collisions), {})
        keys = [gripper.tobytes() for gripper in grippers]
        new = [i for i, key in enumerate(keys) if key not in known]
        if new:
            placed = wxyz_xyz(rigid(target_pose) * rigid(grippers[new]))
            grades = within_reach(self.surroundings.arm_alone, placed, self.seed, collisions)
            known |= {keys[i]: int(grade) for i, grade in zip(new, grades, strict=True)}
        return np.array([known[key] for key in keys], int)

    def timed(self, batches: Iterator[list[Found]]) -> Iterator[list[Found]]:
        """The same batches, the time they take counted as GraspGen's."""
        while (batch := self.clock.time("grasp_gen", lambda: next(batches, None))) is not None:
            yield batch

    def counts(self) -> tuple[int, int]:
        """Grasps evaluated, and starts put in order, so far."""
        evaluated = self.sampled + sum(search.evaluations for search in self.searches)
        return evaluated, sum(search.ordered for search in self.searches)

    # --- one grasp ----------------------------------------------------------------------------------------------------

    def one_grasp(
        self, kind: StageKind, start: Scene, end: Scene, release: Pose, batches: Iterable[Sequence[Grasp]]
    ) -> Stage | Failure | None:
        """A single stage between two scenes by the first grasp whose motion works; None if there are no grasps."""
        failure: Failure | None = None
        attempts = 0
        rejected: list[Ends] = []
        for batch in batches:
            grasps = [either for grasp in batch for either in (grasp, flipped(grasp, self.robot))]
            for grasp, picks, places in self._reachable_at_both(grasps, start.target_pose, release, rejected):
                takes = self.motion.takes(kind, grasp, start.target_pose, picks)
                puts = self.motion.puts(kind, grasp, release, places)
                stage = self.motion.join(
                    kind, grasp, start.target_pose, release, end.target_pose, takes, puts, self.task.start
                )
                if isinstance(stage, Stage):
                    return stage
                failure = furthest(failure, stage)
                attempts += bool(takes and puts)
                if attempts == self.options.motion_attempts:
                    return failure
        return self.unreachable(kind, rejected) if failure is None and rejected else failure

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

    # --- one end of a stage -------------------------------------------------------------------------------------------

    def ends(self, grasps: Sequence[Grasp], target_pose: Pose) -> list[Ends]:
        """Configurations for each grasp of the target standing at one pose."""
        home = np.asarray(self.robot.home)
        return self.clock.time("ik_solve", lambda: solve_ends(self.surroundings, grasps, target_pose, home, self.seed))

    def reached(
        self,
        kind: StageKind,
        batches: Iterable[Sequence[Held]],
        pose: Pose,
        find: Callable[[StageKind, Grasp, Pose, Ends], Reaches],
        keep: int | None = None,
    ) -> tuple[list[Held], Failure | None]:
        """The first grasps by which the target can be taken up or put down at ``pose``, and why the last can not.

        Args:
            kind: what the stage is for.
            batches: grasps, a few at a time.
            pose: (7,) of the target.
            find: `StageMotion.takes` or `StageMotion.puts`.
            keep: grasps that are enough; by default ``options.grasps_kept``.
        """
        keep = keep or self.options.grasps_kept
        failure: Failure | None = None
        found: list[Held] = []
        for batch in batches:
            ends = self.ends([held.grasp for held in batch], pose)
            lacking = [end for end in ends if not end.configurations]
            if lacking:
                failure = furthest(failure, self.unreachable(kind, lacking))
            for held, end in zip(batch, ends, strict=True):
                if not end.configurations:
                    continue
                reaches = find(kind, held.grasp, pose, end)
                if reaches:
                    found.append(Held(held.grasp, held.down, reaches))
                    if len(found) == keep:
                        return found, failure
                else:
                    failure = furthest(failure, reaches.failure)
        return found, failure

    def either_way(self, batches: Iterator[list[Found]]) -> Iterator[list[Held]]:
        """Grasps as they are found, each with the fingers either way round."""
        for batch in self.timed(batches):
            pairs = ((found.grasp, flipped(found.grasp, self.robot)) for found in batch)
            downs = chain.from_iterable((found.release, found.release) for found in batch)
            yield [Held(grasp, down, None) for grasp, down in zip(chain.from_iterable(pairs), downs, strict=True)]

    # --- failures -----------------------------------------------------------------------------------------------------

    def unreachable(self, kind: StageKind, ends: Sequence[Ends] = ()) -> Failure:
        """No configuration at all; the constraint is the one that most of the ``ends`` fail by."""
        name = self.task.target.name
        message = f"no collision-free configuration of the arm reaches the grasps of {name!r} where they are needed"
        # Without the figures, which differ from grasp to grasp.
        constraints = Counter(end.constraint.split(",")[0] for end in ends if end.constraint).most_common(1)
        return Failure(Reason.UNREACHABLE, kind, constraints[0][0] if constraints else "inverse kinematics", message)

    def no_grasp(self, kind: StageKind, search: GraspSearch, where: str) -> Failure:
        """Why a search has given no grasp."""
        name, reason = self.task.target.name, search.reason
        if reason == "too wide":
            opening = 1e3 * float(self.robot.gripper.max_opening) * self.robot.unit
            message = f"{name!r} is wider in every direction than the gripper opens ({opening:.0f} mm)"
            return Failure(Reason.TOO_WIDE, kind, "finger limits", message)
        if reason == "out of reach":
            return self.unreachable(kind)
        if reason == "enclosed" and len(search.scenes) == 1:
            message = f"no grasp of {name!r} keeps clear of the obstacles around it in the {where} scene"
            return Failure(Reason.ENCLOSED, kind, "world collision", message)
        message = f"no grasp of {name!r} keeps clear of the obstacles of {where} together"
        return Failure(Reason.NO_COMMON_GRASP, kind, "world collision" if reason == "enclosed" else reason, message)


_PROGRESS = (
    Reason.TOO_WIDE,
    Reason.NO_STABLE_POSE,
    Reason.ENCLOSED,
    Reason.NO_COMMON_GRASP,
    Reason.UNREACHABLE,
    Reason.NO_PATH,
)


def furthest(one: Failure | None, other: Failure) -> Failure:
    """The failure that came later in the pipeline says most about what to change."""
    return other if one is None else max((one, other), key=lambda failure: _PROGRESS.index(failure.reason))
