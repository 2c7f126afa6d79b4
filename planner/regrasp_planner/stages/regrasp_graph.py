"""The regrasp graph: its nodes are the pick, the placements and the goal, its edges the transfer grasps between them.

A transfer grasp is feasible at both nodes of its edge (eq. (3)). The grasps of an edge are searched for when they are
first asked for, and kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import partial

import numpy as np
from jaxtyping import Float, Int

from regrasp_planner.grasp.grasp_gen import GraspSearch
from regrasp_planner.grasp.reachability import ReachabilityGrader
from regrasp_planner.placement.basins import ReleaseCone, release_cones
from regrasp_planner.placement.release_pose import resting_poses
from regrasp_planner.placement.stab_pose import stable_poses
from regrasp_planner.pose import Pose
from regrasp_planner.stages.failures import no_grasp
from regrasp_planner.stages.motion import LazyMotions
from regrasp_planner.stages.plan import Failure, StageKind
from regrasp_planner.stages.search import GraspCandidate, StageSearch


class Terminal(Enum):
    """Where the chain of stages begins and ends."""

    PICK = "pick"
    GOAL = "goal"


@dataclass(frozen=True, eq=False)
class Placement:
    """A stable pose of the target in the release area, compared and hashed by identity.

    Attributes:
        upright: the ground under the target at rest, as a cone without tilt.
        tilted: the grounds, tilted at the release, from which the target settles into the pose.
        poses: each (7,), where the target can stand in it.
        reachable: grades grasps by whether the arm reaches them in any of the poses.
    """

    upright: ReleaseCone
    tilted: ReleaseCone
    poses: tuple[Pose, ...]
    reachable: ReachabilityGrader


Node = Terminal | Placement


@dataclass(frozen=True, eq=False)
class TransferGrasps:
    """The grasps of one edge, compared and hashed by identity.

    Attributes:
        candidates: the grasps, in the order of preference.
        motions: their motions at the pick or at the goal; empty for an edge between placements.
        failure: why there are none, or no more.
    """

    candidates: tuple[GraspCandidate, ...]
    motions: Mapping[GraspCandidate, LazyMotions] = field(default_factory=dict[GraspCandidate, LazyMotions])
    failure: Failure | None = None


def stage_kind(begin: Node, end: Node) -> StageKind:
    """The kind of the stage along an edge."""
    if begin is Terminal.PICK:
        return StageKind.PICK_TO_PLACE if end is Terminal.GOAL else StageKind.PICK_TO_RELEASE
    return StageKind.REGRASP_TO_PLACE if end is Terminal.GOAL else StageKind.REGRASP_TO_RELEASE


class RegraspGraph:
    """Placements of the target, and transfer grasps between them.

    Args:
        stages: what the stages share.

    Attributes:
        placements: those that fit the release area; first those that stand up to being released, most stable first.
    """

    def __init__(self, stages: StageSearch) -> None:
        self.stages, self.task = stages, stages.task
        effort = stages.options.regrasp
        self._from_pick = stages.grasp_search(effort, self.task.pick)
        self._to_goal = stages.grasp_search(effort, self.task.place)
        self._on_ground = stages.grasp_search(effort)
        self._transfer_grasps: dict[tuple[Node, Node, bool], TransferGrasps] = {}
        self.placements = tuple(self._placements())[: stages.options.max_stable_poses]

    def transfer_grasps(self, begin: Node, end: Node, tilted: bool) -> TransferGrasps:
        """Grasps from one node to the next; at a placement the target may be released ``tilted``, to settle there."""
        key = (begin, end, tilted and end is not Terminal.GOAL)
        if key not in self._transfer_grasps:
            self._transfer_grasps[key] = self._find(begin, end, tilted)
        return self._transfer_grasps[key]

    def _placements(self) -> Iterator[Placement]:
        target, options, hull = self.task.target, self.stages.options, self.task.target.hull_vertices()
        with self.stages.clock("stab_pose"):
            stable = stable_poses(hull, target.center_of_mass)
        cones = release_cones(stable)
        for k in sorted(range(len(stable)), key=lambda k: cones[k].half_angle <= 0):
            poses = tuple(
                resting_poses(self.task.release, hull, stable.rotations[k], options.yaws, options.release_positions)
            )
            if poses:
                yield Placement(ReleaseCone(cones[k].axis, 0.0), cones[k], poses, partial(self._grade_in_any, poses))

    def _grade_in_any(self, poses: Sequence[Pose], grippers: Float[np.ndarray, "K 7"]) -> Int[np.ndarray, " K"]:
        """Grade K grasps by the first of several poses on free ground in which the arm reaches them."""
        grades = np.zeros(len(grippers), int)
        for pose in poses:
            left = np.flatnonzero(grades == 0)
            if len(left):
                grades[left] = self.stages.quick_reachability(pose, grippers[left], collisions=False)
        return grades

    def _find(self, begin: Node, end: Node, tilted: bool) -> TransferGrasps:
        stages, motion, kind = self.stages, self.stages.motion, stage_kind(begin, end)
        start = begin.upright if isinstance(begin, Placement) else None
        ground = (end.tilted if tilted else end.upright) if isinstance(end, Placement) else None
        reachable = [node.reachable for node in (begin, end) if isinstance(node, Placement)]

        def candidates(search: GraspSearch) -> Iterator[list[GraspCandidate]]:
            return stages.candidates(search.grasps(start, ground, reachable))

        if begin is Terminal.PICK:
            pick = self.task.pick
            batches = candidates(self._from_pick)
            motions, failure = stages.plan_motions(kind, batches, pick.target_pose, motion.pick_motions)
            if not motions and failure is None:
                failure = self._no_grasp(self._from_pick, kind, pick.name)
            assert ground is not None
            return TransferGrasps(_least_tilted_first(motions, ground), motions, failure)
        if end is Terminal.GOAL:
            motions, failure = stages.plan_motions(kind, candidates(self._to_goal), stages.goal, motion.place_motions)
            if not motions and failure is None:
                failure = self._no_grasp(self._to_goal, kind, self.task.place.name)
            return TransferGrasps(tuple(motions), motions, failure)
        found: list[GraspCandidate] = []
        for batch in candidates(self._on_ground):
            found += batch
            if len(found) >= 2 * stages.options.grasps_kept:
                break
        failure = None if found else no_grasp(self._on_ground, kind, "both stable poses", stages.robot)
        return TransferGrasps(tuple(found), failure=failure)

    def _no_grasp(self, search: GraspSearch, kind: StageKind, scene: str) -> Failure:
        where = f"{scene} and release" if search.any_feasible else scene
        return no_grasp(search, kind, where, self.stages.robot)


def _least_tilted_first(candidates: Iterable[GraspCandidate], ground: ReleaseCone) -> tuple[GraspCandidate, ...]:
    def tilt(candidate: GraspCandidate) -> float:
        assert candidate.down is not None
        return float(np.round(-candidate.down @ ground.axis, 3))

    return tuple(sorted(candidates, key=tilt))
