"""The order in which GraspGen evaluates its initial grasps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from regrasp_planner.geometry.boxes import bounding_boxes
from regrasp_planner.grasp.broad_phase import overlaps
from regrasp_planner.grasp.grasp import Grasp, GraspGenOptions
from regrasp_planner.grasp.open_gripper import OpenGripper
from regrasp_planner.grasp.problem import GraspProblem
from regrasp_planner.grasp.starts import InitialGrasps
from regrasp_planner.robot.gripper import reduce_gripper

CHUNK = 32
"""Starts whose reachability is graded at once."""
FREE_CHUNKS = 8
"""Chunks searched for starts that the arm reaches free of collision, before starts of grade 1 are evaluated."""

ChunkGrades = Callable[[Int[np.ndarray, " C"]], Int[np.ndarray, " C"]]
"""Reachability grades of a chunk of starts, by index; see `ReachabilityGrades`."""


class StartOrder(NamedTuple):
    """Order of K initial grasps.

    Attributes:
        indices: (K,) the starts, most promising first.
        deep_overlap: (K,) by start, whether its bounding boxes overlap obstacles too deeply to evaluate it.
    """

    indices: Int[np.ndarray, " K"]
    deep_overlap: Bool[np.ndarray, " K"]

    @staticmethod
    def unsorted(count: int) -> StartOrder:
        """The starts as they are."""
        return StartOrder(np.arange(count), np.zeros(count, bool))


def sort_starts(
    starts: InitialGrasps,
    problem: GraspProblem,
    center_of_mass: Float[np.ndarray, " 3"],
    hand: OpenGripper,
    options: GraspGenOptions,
) -> StartOrder:
    """Sort by overlap of bounding boxes and missing depth, then by free space and distance from the centre of mass."""
    boxes, box_poses = bounding_boxes(problem.obstacles), np.asarray(problem.obstacle_poses)
    overlap, gap = overlaps(starts.poses, hand.opened(starts.thetas), hand.gripper, boxes, box_poses, hand.margin)
    depth = options.depth * reduce_gripper(hand.gripper).tip_length
    lever = np.linalg.norm(starts.poses[:, 4:] - center_of_mass, axis=1)
    cost = overlap + np.maximum(0.0, depth - starts.depths) - 0.1 * np.clip(gap, 0.0, 6 * hand.margin)
    return StartOrder(np.argsort(cost + 0.03 * lever, kind="stable"), gap < -options.deep * hand.length)


def screening_order(
    starts: InitialGrasps,
    candidates: Int[np.ndarray, " K"],
    refused: Sequence[Grasp],
    grades: ChunkGrades,
    length: float,
) -> Iterator[int]:
    """Reachable candidates, in the order to evaluate them.

    Starts reached free of collision come first. Within a grade and chunk, diverse starts come first; starts similar to
    refused grasps come last.

    Args:
        starts: the initial grasps.
        candidates: indices of starts, most promising first.
        refused: grasps found so far, which the caller did not accept; may grow meanwhile.
        grades: see `ChunkGrades`.
        length: widest opening of the gripper, metres.
    """
    chunks = [candidates[begin : begin + CHUNK] for begin in range(0, len(candidates), CHUNK)]
    for grade, some in ((2, chunks[:FREE_CHUNKS]), (1, chunks)):
        for chunk in some:
            graded = grades(chunk)
            if not (graded == grade).any():
                continue
            waiting = [k for k in _diverse_first(starts.poses[chunk], 0.15 * length) if graded[k] == grade]
            while waiting:
                unlike = (k for k in waiting if not _similar(starts.poses[chunk[k]], refused))
                following = next(unlike, waiting[0])
                waiting.remove(following)
                yield int(chunk[following])


def _similar(pose: Float[np.ndarray, " 7"], grasps: Sequence[Grasp]) -> bool:
    """Whether a gripper pose is turned by less than 30° against one of the grasps."""
    return any(abs(float(pose[:4] @ grasp.pose[:4])) > np.cos(np.radians(15)) for grasp in grasps)


def _diverse_first(poses: Float[np.ndarray, "K 7"], distance: float) -> list[int]:
    """Indices of the poses, those first that differ from all such before by 20° or by ``distance``."""
    diverse: list[int] = []
    rest: list[int] = []
    for i in range(len(poses)):
        same_turn = np.abs(poses[diverse, :4] @ poses[i, :4]) > np.cos(np.radians(10))
        near = np.linalg.norm(poses[diverse, 4:] - poses[i, 4:], axis=1) < distance
        (rest if (same_turn & near).any() else diverse).append(i)
    return [*diverse, *rest]
