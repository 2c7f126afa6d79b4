"""GraspGen: force-closure grasps that are free of collision in several scenes at once (the paper's Alg. 1, eq. 1–4).

Initial grasps come from critical directions of the target's width function (`starts`). A broad phase sorts them
(`start_order`), and a few at a time are evaluated among the union of all scenes' obstacles (`problem`, `evaluator`);
often the first ones are feasible. If none is, the augmented Lagrangian with the Riemannian trust region refines the
most promising ones. The ground under the target is a plane (`ground`), which needs no evaluation.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property, partial
from itertools import islice

import numpy as np
from jaxtyping import Bool, Float

from regrasp_planner.grasp.evaluator import BATCH, GraspEvaluator
from regrasp_planner.grasp.grasp import FeasibleGrasp, Grasp, GraspGenOptions, GraspResult, NoGraspReason, StartKind
from regrasp_planner.grasp.ground import Ground, GroundCheck
from regrasp_planner.grasp.objective import GraspScore
from regrasp_planner.grasp.open_gripper import OpenGripper
from regrasp_planner.grasp.reachability import ReachabilityGrader, ReachabilityGrades
from regrasp_planner.grasp.start_order import CHUNK, ChunkGrades, StartOrder, screening_order, sort_starts
from regrasp_planner.grasp.starts import InitialGrasps, initial_grasps
from regrasp_planner.placement.basins import ReleaseCone
from regrasp_planner.robot.model import Gripper
from regrasp_planner.task import Body, Scene

OUTER_ROUNDS = 2
"""Rounds of Algorithm 3: in each, grasps are refined and then the ground is tilted anew."""
PATIENCE = 3
"""Factor on the number of evaluated starts if there are feasible grasps, but the caller refuses them."""


class GraspSearch:
    """GraspGen and GraspGen⁺ for one target among the obstacles of one or more scenes.

    Scores and grades are kept: searching again with another ground under the target costs only what is new.

    Args:
        target: the body to grasp, convex pieces in its own frame.
        scenes: scenes that the same grasp must be feasible in, such as pick and place; none for free space.
        gripper: the two-finger gripper.
        options: see `GraspGenOptions`.
        grader: grades the reachability of starts before they are evaluated.
        seed: seed of the uniform starts.

    Attributes:
        ordered: initial grasps sorted by the broad phase so far, which evaluates none of them.
    """

    def __init__(
        self,
        target: Body,
        scenes: Sequence[Scene],
        gripper: Gripper,
        options: GraspGenOptions | None = None,
        grader: ReachabilityGrader | None = None,
        seed: int = 0,
    ) -> None:
        self.target, self.scenes, self.gripper = target, tuple(scenes), gripper
        self.options, self.seed = options or GraspGenOptions(), seed
        self.ordered = 0
        self._hand = OpenGripper.of(gripper, self.options.margin)
        self._evaluator = GraspEvaluator(target, self.scenes, self._hand, self.options)
        self._graders = () if grader is None else (grader,)
        self._refined: list[tuple[Float[np.ndarray, " 7"], GraspScore]] = []

    @property
    def evaluations(self) -> int:
        """Grasps evaluated so far; each member of a batch counts."""
        return self._evaluator.count

    @property
    def any_feasible(self) -> bool:
        """Whether any grasp evaluated so far is feasible, whatever the ground under the target."""
        return bool(self._refined) or any(self._start_grasp(i) for i in self._evaluator.scores)

    @property
    def reason(self) -> NoGraspReason:
        """Why there is no grasp, once a search has ended without one."""
        if len(self._starts.poses) == 0:
            return NoGraspReason.TOO_WIDE
        if self._grades.none_reachable:
            return NoGraspReason.OUT_OF_REACH
        return NoGraspReason.POOR_QUALITY if self._evaluator.contact_found else NoGraspReason.ENCLOSED

    def grasps(
        self,
        start: ReleaseCone | None = None,
        end: ReleaseCone | None = None,
        graders: Sequence[ReachabilityGrader] = (),
    ) -> Iterator[list[FeasibleGrasp]]:
        """Feasible grasps, a few at a time, those in most free space first; stop when there are enough.

        Args:
            start: the ground under the target at pick, as the cone of a stable pose, of which only the axis counts.
            end: the ground at release. If its half-angle is positive, the plane may tilt within the cone (GraspGen⁺,
                Algorithm 3); otherwise the release is static.
            graders: further graders of reachability, such as for other poses of the target. Grades are kept by the
                identity of the grader.
        """
        if len(self._starts.poses) == 0:
            return
        grades = partial(self._grades.of, graders=(*self._graders, *graders))
        ground = Ground(self.target, self._hand, start, end)
        check = ground.check(self._corners) if ground.exists else GroundCheck.unbounded(len(self._starts.poses))
        tried: list[int] = []
        if self.options.starts is StartKind.CRITICAL:
            refused: list[Grasp] = []
            for batch in self._screened(check.clear, refused, grades):
                tried += batch
                grasps = [(i, self._start_grasp(i)) for i in batch]
                found = [FeasibleGrasp(grasp, check.release[i]) for i, grasp in grasps if grasp is not None]
                if found := ground.settling(found):
                    yield found
                    refused += [each.grasp for each in found]
        if found := self._feasible(self._refined, ground):
            yield found
        promising = self._promising(tried, check.clear, grades)
        for begin in range(0, len(promising), BATCH):
            solved = self._evaluator.refine(
                self._starts, promising[begin : begin + BATCH], ground.planes, OUTER_ROUNDS if ground.tilts else 1
            )
            self._refined += [each for each in solved if self._evaluator.grasp(*each)]
            if found := self._feasible(solved, ground):
                yield found

    @cached_property
    def _starts(self) -> InitialGrasps:
        return initial_grasps(self.target, self._hand, self.options, self.seed)

    @cached_property
    def _order(self) -> StartOrder:
        count = len(self._starts.poses)
        if self.options.starts is StartKind.UNIFORM:
            return StartOrder.unsorted(count)
        self.ordered += count
        center = self.target.center_of_mass
        return sort_starts(self._starts, self._evaluator.problem, center, self._hand, self.options)

    @cached_property
    def _grades(self) -> ReachabilityGrades:
        return ReachabilityGrades(self._starts.poses)

    @cached_property
    def _corners(self) -> Float[np.ndarray, "K G 3"]:
        return self._hand.corners(self._starts.poses, self._starts.thetas)

    def _start_grasp(self, i: int) -> Grasp | None:
        """The evaluated initial grasp i, if it is feasible."""
        return self._evaluator.grasp(self._starts.poses[i], self._evaluator.scores[i])

    def _feasible(
        self, solved: Sequence[tuple[Float[np.ndarray, " 7"], GraspScore]], ground: Ground
    ) -> list[FeasibleGrasp]:
        """Those of the refined poses that are feasible and clear the ground."""
        grasps = [self._evaluator.grasp(*each) for each in solved]
        return ground.feasible([grasp for grasp in grasps if grasp is not None])

    def _screened(
        self, clear: Bool[np.ndarray, " K"], refused: Sequence[Grasp], grades: ChunkGrades
    ) -> Iterator[list[int]]:
        """Batches of evaluated starts: those known from other searches, then new ones within the budgets."""
        order, known = self._order.indices, self._evaluator.scores
        evaluated = np.array([i for i in order if clear[i] and int(i) in known], int)
        again = iter(evaluated[grades(evaluated) > 0].tolist())
        while batch := list(islice(again, BATCH)):
            yield batch
        candidates = order[(clear & ~self._order.deep_overlap)[order]]
        screening = screening_order(self._starts, candidates, refused, grades, self._hand.length)
        new = (i for i in screening if i not in known)
        spent = 0
        while spent < self.options.screened * (PATIENCE if refused else 1) and self.evaluations < self.options.budget:
            batch = list(islice(new, BATCH))
            if not batch:
                return
            self._evaluator.evaluate(self._starts, batch)
            spent += len(batch)
            yield batch

    def _promising(self, tried: Sequence[int], clear: Bool[np.ndarray, " K"], grades: ChunkGrades) -> list[int]:
        """Starts to refine: the nearest to feasible of those tried, then such as only the ground is in the way of."""
        if self.evaluations >= self.options.budget:
            return []
        order = self._order.indices
        if self.options.starts is StartKind.UNIFORM:
            return order.tolist()
        scores = self._evaluator.scores
        merit = {i: scores[i].total_violation - 0.2 * scores[i].quality for i in tried if self._start_grasp(i) is None}
        chosen = sorted(merit, key=lambda i: merit[i])[: self.options.refined]
        if len(chosen) == self.options.refined:
            return chosen
        untried = np.setdiff1d(order, np.asarray(tried, int), assume_unique=True)
        others = untried[np.argsort(~clear[untried], kind="stable")][:CHUNK]
        return [*chosen, *others[grades(others) > 0].tolist()][: self.options.refined]


def generate_grasps(
    target: Body, scenes: Sequence[Scene], gripper: Gripper, options: GraspGenOptions | None = None, seed: int = 0
) -> GraspResult:
    """Grasps that hold the target and keep clear of the obstacles of all ``scenes`` (Alg. 1).

    Args:
        target: the body to grasp, convex pieces in its own frame.
        scenes: scenes that the same grasp must be feasible in, such as pick and place.
        gripper: the two-finger gripper.
        options: see `GraspGenOptions`.
        seed: seed of the uniform starts, if the options ask for those.
    """
    search = GraspSearch(target, scenes, gripper, options, seed=seed)
    length = float(gripper.max_opening)
    grasps: list[Grasp] = []
    for batch in search.grasps():
        grasps = _distinct([*grasps, *(found.grasp for found in batch)], length)
        if len(grasps) >= search.options.enough:
            break
    if not grasps:
        return GraspResult((), search.evaluations, search.reason)
    # A grasp near the centre of mass has less of a torque to hold: an opening's distance counts as 0.3 of quality.
    grasps.sort(
        key=lambda grasp: 0.3 * float(np.linalg.norm(grasp.pose[4:] - target.center_of_mass)) / length - grasp.quality
    )
    return GraspResult(tuple(grasps), search.evaluations, None)


def _distinct(grasps: Sequence[Grasp], length: float) -> list[Grasp]:
    """The grasps without those within 0.05 rad and 5 % of ``length`` of an earlier one."""
    kept: list[Grasp] = []
    for grasp in grasps:
        alike = (
            abs(float(grasp.pose[:4] @ other.pose[:4])) > np.cos(0.025)
            and np.linalg.norm(grasp.pose[4:] - other.pose[4:]) < 0.05 * length
            for other in kept
        )
        if not any(alike):
            kept.append(grasp)
    return kept
