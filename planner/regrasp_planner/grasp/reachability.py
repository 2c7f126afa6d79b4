"""Grades of how well the arm reaches initial grasps, each asked for once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float, Int

ReachabilityGrader = Callable[[Float[np.ndarray, "K 7"]], Int[np.ndarray, " K"]]
"""Grades K gripper poses in the target's frame: 0 out of reach, 1 reachable, 2 reachable free of collision."""


class ReachabilityGrades:
    """Grades of one set of initial grasps, kept by grader.

    Args:
        poses: (K, 7) gripper poses in the target's frame.
    """

    def __init__(self, poses: Float[np.ndarray, "K 7"]) -> None:
        self._poses = poses
        self._known: dict[ReachabilityGrader, dict[int, int]] = {}

    @property
    def none_reachable(self) -> bool:
        """Whether graders were asked, and all of their grades so far are 0."""
        return bool(self._known) and not any(any(grades.values()) for grades in self._known.values())

    def of(self, indices: Int[np.ndarray, " C"], graders: Sequence[ReachabilityGrader]) -> Int[np.ndarray, " C"]:
        """The least grade of each pose over all graders; 1 without graders. Poses of grade 0 are not graded further."""
        grades = np.full(len(indices), 2 if graders else 1)
        for grader in graders:
            known = self._known.setdefault(grader, {})
            new = np.array([i for i, grade in zip(indices, grades, strict=True) if grade and int(i) not in known], int)
            if len(new):
                known |= {int(i): int(grade) for i, grade in zip(new, grader(self._poses[new]), strict=True)}
            grades = np.minimum(grades, [known.get(int(i), 0) for i in indices])
        return grades
