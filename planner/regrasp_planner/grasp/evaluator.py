"""Evaluation and refinement of initial grasps, counted, with the scores kept."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property

import jax
import numpy as np
from jaxtyping import Float

from regrasp_planner.grasp.grasp import Grasp, GraspGenOptions
from regrasp_planner.grasp.objective import GraspScore, evaluate, refine
from regrasp_planner.grasp.open_gripper import OpenGripper
from regrasp_planner.grasp.problem import GraspProblem, grasp_problem
from regrasp_planner.grasp.starts import InitialGrasps
from regrasp_planner.task import Body, Scene

BATCH = 4
"""Grasps evaluated, or refined, in one call of the compiled program."""
VIOLATION = 0.01
"""Largest violation of a constraint that counts as none, in gripper openings."""

GroundPlanes = Callable[[Float[np.ndarray, "B 7"], Float[np.ndarray, " B"]], Float[np.ndarray, "B 2 4"]]
"""Planes of the ground at pick and release for grasps with given poses and finger coordinates."""


class GraspEvaluator:
    """Scores grasps of one target in the union of several scenes.

    Args:
        target: the target.
        scenes: scenes that a grasp must be feasible in.
        hand: the gripper.
        options: see `GraspGenOptions`.

    Attributes:
        count: grasps evaluated so far; each member of a batch counts.
        scores: scores of the initial grasps evaluated so far, by index.
        contact_found: whether any grasp so far meets all constraints, of whatever quality.
    """

    def __init__(self, target: Body, scenes: Sequence[Scene], hand: OpenGripper, options: GraspGenOptions) -> None:
        self._target, self._scenes, self._hand, self._options = target, scenes, hand, options
        self.count = 0
        self.scores: dict[int, GraspScore] = {}
        self.contact_found = False

    @cached_property
    def problem(self) -> GraspProblem:
        """The problem without a ground."""
        return grasp_problem(self._target, self._scenes, self._hand.gripper, self._options)

    def evaluate(self, starts: InitialGrasps, indices: Sequence[int]) -> None:
        """Score up to `BATCH` initial grasps, without the ground."""
        batch = starts.at(np.resize(np.asarray(indices), BATCH))
        scaled = batch.thetas[:, None] / self._hand.stroke
        scores = jax.device_get(evaluate(batch.poses, scaled, batch.parts, self.problem)).unstacked(len(indices))
        self.count += len(indices)
        self.scores |= dict(zip(indices, scores, strict=True))
        self._note_contact(scores)

    def refine(
        self, starts: InitialGrasps, indices: Sequence[int], planes: GroundPlanes, rounds: int
    ) -> list[tuple[Float[np.ndarray, " 7"], GraspScore]]:
        """Poses and scores of up to `BATCH` initial grasps after Algorithm 1, in ``rounds`` with new planes each."""
        batch = starts.at(np.resize(np.asarray(indices), BATCH))
        poses, thetas, stroke = batch.poses, batch.thetas, self._hand.stroke
        scores: list[GraspScore] = []
        for _ in range(rounds):
            solved = refine(
                poses,
                thetas[:, None] / stroke,
                batch.parts,
                planes(poses, thetas),
                self.problem,
                self._options.max_evaluations // rounds,
                length=self._hand.length,
            )
            poses, stacked, spent = jax.device_get(solved)
            thetas, scores = stacked.scaled_theta[:, 0] * stroke, stacked.unstacked(len(indices))
            self.count += int(spent[: len(indices)].sum())
        self._note_contact(scores)
        return list(zip(poses, scores, strict=False))

    def grasp(self, pose: Float[np.ndarray, " 7"], score: GraspScore) -> Grasp | None:
        """The grasp with a pose and score, if it is feasible."""
        if not _meets_constraints(score) or score.quality < self._options.quality_threshold:
            return None
        theta = float(score.scaled_theta[0]) * self._hand.stroke
        opening = float(self._hand.opened(theta))
        return Grasp(np.asarray(pose), theta, opening, float(score.quality), float(score.clearance))

    def _note_contact(self, scores: Iterable[GraspScore]) -> None:
        self.contact_found |= any(map(_meets_constraints, scores))


def _meets_constraints(score: GraspScore) -> bool:
    return bool(np.isfinite(score.violation) and score.violation <= VIOLATION)
