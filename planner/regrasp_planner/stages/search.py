"""What the stages of one task share: grasp searches, reachability, inverse kinematics and motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from regrasp_planner.grasp.grasp import FeasibleGrasp, Grasp, GraspGenOptions
from regrasp_planner.grasp.grasp_gen import GraspSearch
from regrasp_planner.ik.reachability import Reachability, grade_reachability
from regrasp_planner.pose import Pose, rigid, wxyz_xyz
from regrasp_planner.robot.model import Robot
from regrasp_planner.stages.clock import Clock
from regrasp_planner.stages.collision_models import CollisionModels
from regrasp_planner.stages.failures import most_advanced_failure, unreachable
from regrasp_planner.stages.grasp_ik import GraspIk, solve_grasp_ik, with_flipped
from regrasp_planner.stages.motion import LazyMotions, PathObserver, StageMotion
from regrasp_planner.stages.options import PlanOptions
from regrasp_planner.stages.plan import Failure, StageKind
from regrasp_planner.task import Scene, Task


@dataclass(frozen=True, eq=False)
class GraspCandidate:
    """A grasp that a search found, compared and hashed by identity.

    Attributes:
        grasp: the grasp.
        down: (3,) direction in the target's frame that points down at the release; None if that is no placement.
    """

    grasp: Grasp
    down: Float[np.ndarray, " 3"] | None


Motions = dict[GraspCandidate, LazyMotions]
"""Motions at one end of a stage by grasp candidate, in the order of preference."""


class StageSearch:
    """What the stages of one task share.

    Args:
        task: the task.
        robot: arm, gripper and their bodies.
        seed: seed of the random starts.
        options: see `PlanOptions`.
        observer: told of every path query.

    Attributes:
        clock: seconds by module.
        models: collision models.
        motion: plans the motion of a stage.
        goal: (7,) pose in which the target is released at its goal, a little above it.
        searches: all grasp searches made.
        sampled: grasps evaluated by the sampling baseline.
    """

    def __init__(
        self, task: Task, robot: Robot, seed: int, options: PlanOptions, observer: PathObserver | None = None
    ) -> None:
        self.task, self.robot, self.seed, self.options = task, robot, seed, options
        self.clock = Clock()
        self.models = CollisionModels(robot, task.target, task.pick.obstacles, options.motion)
        self.motion = StageMotion(self.models, self.clock, seed, observer)
        self.searches: list[GraspSearch] = []
        self.sampled = 0
        self._grades: dict[tuple[bytes, bool], dict[bytes, int]] = {}
        self.goal = np.array(task.place.target_pose, float)
        self.goal[6] += options.motion.drop

    def grasp_search(self, options: GraspGenOptions, *scenes: Scene) -> GraspSearch:
        """A search for grasps that are feasible and, obstacles aside, reachable in all the scenes."""

        def reachable(grippers: Float[np.ndarray, "K 7"]) -> Int[np.ndarray, " K"]:
            grades = np.full(len(grippers), int(Reachability.FREE))
            for scene in scenes:
                left = np.flatnonzero(grades)
                grades[left] = np.minimum(grades[left], self.quick_reachability(scene.target_pose, grippers[left]))
            return grades

        made = GraspSearch(
            self.task.target, scenes, self.robot.gripper, options, reachable if scenes else None, self.seed
        )
        self.searches.append(made)
        return made

    def quick_reachability(
        self, target_pose: Pose, grippers: Float[np.ndarray, "K 7"], collisions: bool = True
    ) -> Int[np.ndarray, " K"]:
        """Grade how well the arm alone reaches grasps; see `Reachability`.

        Searches share their starts, so that each is graded once.

        Args:
            target_pose: (7,) of the target, in the world.
            grippers: (K, 7) gripper poses in the target's frame.
            collisions: whether collisions of the arm count.
        """
        known = self._grades.setdefault((np.asarray(target_pose, float).tobytes(), collisions), {})
        keys = [gripper.tobytes() for gripper in grippers]
        new = [i for i, key in enumerate(keys) if key not in known]
        if new:
            placed = wxyz_xyz(rigid(target_pose) * rigid(grippers[new]))
            grades = grade_reachability(self.models.arm_alone, placed, self.seed, collisions)
            known |= {keys[i]: int(grade) for i, grade in zip(new, grades, strict=True)}
        return np.array([known[key] for key in keys], int)

    def candidates(self, batches: Iterator[list[FeasibleGrasp]]) -> Iterator[list[GraspCandidate]]:
        """Grasps as they are found, each with the fingers either way round."""
        for batch in self.clock.each("grasp_gen", batches):
            yield [
                GraspCandidate(grasp, found.release)
                for found in batch
                for grasp in with_flipped([found.grasp], self.robot)
            ]

    def grasp_ik(self, grasps: Sequence[Grasp], target_pose: Pose) -> list[GraspIk]:
        """Configurations for each grasp of the target at one pose (7,)."""
        with self.clock("ik_solve"):
            return solve_grasp_ik(self.models, grasps, target_pose, np.asarray(self.robot.home), self.seed)

    def plan_motions(
        self,
        kind: StageKind,
        batches: Iterable[Sequence[GraspCandidate]],
        target_pose: Pose,
        motions_at: Callable[[StageKind, GraspIk], LazyMotions],
        keep: int | None = None,
    ) -> tuple[Motions, Failure | None]:
        """The first candidates with a motion to the target at one pose, and why the others have none.

        Args:
            kind: what the stage is for.
            batches: candidates, a few at a time.
            target_pose: (7,) of the target.
            motions_at: `StageMotion.pick_motions` or `StageMotion.place_motions`.
            keep: number of candidates to stop at; by default ``options.grasps_kept``.
        """
        keep = keep or self.options.grasps_kept
        failure: Failure | None = None
        found: Motions = {}
        for batch in batches:
            iks = self.grasp_ik([candidate.grasp for candidate in batch], target_pose)
            failed = [ik for ik in iks if not ik.configurations]
            if failed:
                failure = most_advanced_failure(failure, unreachable(self.task.target, kind, failed))
            for candidate, ik in zip(batch, iks, strict=True):
                if not ik.configurations:
                    continue
                motions = motions_at(kind, ik)
                if motions.any_feasible():
                    found[candidate] = motions
                    if len(found) == keep:
                        return found, failure
                else:
                    failure = most_advanced_failure(failure, motions.failure)
        return found, failure

    def counts(self) -> tuple[int, int]:
        """Grasps evaluated, and starts put in order, so far."""
        evaluated = self.sampled + sum(search.evaluations for search in self.searches)
        return evaluated, sum(search.ordered for search in self.searches)
