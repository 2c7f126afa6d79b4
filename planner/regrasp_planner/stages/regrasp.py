"""Regrasps: the target is put down in one of its stable poses, once or several times, and taken again another way.

A chain pick → k₁ → … → kₙ → goal leads through placements k of the regrasp graph. Transfer grasps for all its edges
are found first; motion is planned only for chains that have them, the shortest and most stable ones first.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise, permutations

import numpy as np
from jaxtyping import Float

from regrasp_planner.placement.release_pose import tilted_pose
from regrasp_planner.pose import Pose
from regrasp_planner.stages.failures import most_advanced_failure, no_stable_pose, unreachable
from regrasp_planner.stages.grasp_ik import GraspIk
from regrasp_planner.stages.plan import Failure, Outcome, Stage, StageKind
from regrasp_planner.stages.regrasp_graph import Node, Placement, RegraspGraph, Terminal, TransferGrasps, stage_kind
from regrasp_planner.stages.search import GraspCandidate, Motions, StageSearch

Chain = Sequence[Placement]


class RegraspSearch:
    """Searches chains of stages through the placements of the target.

    Args:
        stages: what the stages share.
    """

    def __init__(self, stages: StageSearch) -> None:
        self.stages, self.task, self.options = stages, stages.task, stages.options
        self.graph = RegraspGraph(stages)
        self._hull = self.task.target.hull_vertices()
        self._pick_cache: dict[tuple[TransferGrasps, bytes], tuple[Motions, Failure | None]] = {}
        self._release_ik: dict[tuple[GraspCandidate, bytes], GraspIk] = {}

    def once(self, tilted: bool) -> Outcome:
        """One regrasp; the target is released in its stable pose, or ``tilted``, to settle into it."""
        placements = self.graph.placements
        return self._first(((placement,) for placement in placements), tilted, len(placements))

    def repeated(self) -> Outcome:
        """Several regrasps, each in another stable pose."""
        placements = self.graph.placements
        outcome: Outcome = no_stable_pose(self.task.target)
        for length in range(2, self.options.max_stages):
            orders = sorted(permutations(range(len(placements)), length), key=lambda order: (sum(order), order))
            chains = (tuple(placements[k] for k in order) for order in orders)
            outcome = self._first(chains, True, self.options.chains)
            if not isinstance(outcome, Failure):
                break
        return outcome

    def _first(self, chains: Iterable[Chain], tilted: bool, limit: int) -> Outcome:
        """The stages of the first chain that works, of at most ``limit`` chains that have grasps for all edges."""
        failure: Failure | None = None
        tried = 0
        for chain in chains:
            missing = self._missing_grasp(chain, tilted)
            if missing is not None:
                failure = most_advanced_failure(failure, missing)
                continue
            picks = self.graph.transfer_grasps(Terminal.PICK, chain[0], tilted)
            motions = {candidate: picks.motions[candidate] for candidate in picks.candidates}
            outcome = self._plan_from(Terminal.PICK, chain, tilted, motions, np.asarray(self.task.start))
            if not isinstance(outcome, Failure):
                return outcome
            failure = most_advanced_failure(failure, outcome)
            tried += 1
            if tried == limit:
                break
        return failure or no_stable_pose(self.task.target)

    def _missing_grasp(self, chain: Chain, tilted: bool) -> Failure | None:
        """Why one of the edges has no grasp; None if all have. The likeliest to have none come first."""
        for begin, end in ((chain[-1], Terminal.GOAL), (Terminal.PICK, chain[0]), *pairwise(chain)):
            grasps = self.graph.transfer_grasps(begin, end, tilted)
            if not grasps.candidates:
                assert grasps.failure is not None
                return grasps.failure
        return None

    def _plan_from(
        self, node: Node, chain: Chain, tilted: bool, motions: Motions, configuration: Float[np.ndarray, " n"]
    ) -> Outcome:
        """The stages from a node through the rest of the chain to the goal.

        Args:
            node: where the target is.
            chain: placements still ahead.
            tilted: whether the target may be released tilted.
            motions: of the transfer grasps to the first placement ahead, or to the goal, at the target's pose.
            configuration: (n,) of the arm, radians.
        """
        if not chain:
            return self._plan_to_goal(node, tilted, motions, configuration)
        kind = stage_kind(node, chain[0])
        onward = self.graph.transfer_grasps(chain[0], chain[1] if len(chain) > 1 else Terminal.GOAL, tilted)
        failure: Failure | None = None
        tried = 0
        for settled in self._settled_poses(chain[0], tuple(motions), onward.candidates):
            outcome, moved = self._plan_over(settled, node, chain, tilted, motions, configuration)
            if not isinstance(outcome, Failure):
                return outcome
            failure = most_advanced_failure(failure, outcome)
            tried += moved
            if tried == self.options.motion_attempts:
                break
        return failure or unreachable(self.task.target, kind)

    def _plan_over(
        self,
        settled: Pose,
        node: Node,
        chain: Chain,
        tilted: bool,
        motions: Motions,
        configuration: Float[np.ndarray, " n"],
    ) -> tuple[Outcome, bool]:
        """The stages with the target coming to rest at one pose next, and whether the first of them has motion."""
        kind, motion = stage_kind(node, chain[0]), self.stages.motion
        following = chain[1] if len(chain) > 1 else Terminal.GOAL
        releases, failure = self._solve_releases(kind, tuple(motions), settled)
        onward: Motions = {}
        if releases:
            onward, failure = self._pick_up(chain[0], following, tilted, settled)
        if not onward:
            return failure or unreachable(self.task.target, stage_kind(chain[0], following)), False
        failure = None
        for candidate, ik in releases:
            place = motion.place_motions(kind, ik, wide=not _same_rotation(ik.target_pose, settled))
            stage = motion.connect(kind, motions[candidate], place, settled, configuration)
            if isinstance(stage, Stage):
                rest = self._plan_from(chain[0], chain[1:], tilted, onward, stage.end)
                return most_advanced_failure(failure, rest) if isinstance(rest, Failure) else (stage, *rest), True
            failure = most_advanced_failure(failure, stage)
        assert failure is not None
        return failure, False

    def _plan_to_goal(
        self, node: Node, tilted: bool, motions: Motions, configuration: Float[np.ndarray, " n"]
    ) -> Outcome:
        places = self.graph.transfer_grasps(node, Terminal.GOAL, tilted).motions
        failure: Failure | None = None
        for candidate, pick in motions.items():
            stage = self.stages.motion.connect(
                StageKind.REGRASP_TO_PLACE, pick, places[candidate], self.task.place.target_pose, configuration
            )
            if isinstance(stage, Stage):
                return (stage,)
            failure = most_advanced_failure(failure, stage)
        return failure or unreachable(self.task.target, StageKind.REGRASP_TO_PLACE)

    def _settled_poses(
        self, placement: Placement, arriving: Sequence[GraspCandidate], leaving: Sequence[GraspCandidate]
    ) -> list[Pose]:
        """Poses of a placement that both some arriving and some leaving grasp reach at a quick look, the best first."""
        grippers = [np.array([candidate.grasp.pose for candidate in some]) for some in (arriving, leaving)]
        grades = [
            min(int(self.stages.quick_reachability(pose, some, False).max()) for some in grippers)
            for pose in placement.poses
        ]
        return [placement.poses[i] for i in sorted(range(len(grades)), key=lambda i: -grades[i]) if grades[i]]

    def _pick_up(self, node: Placement, following: Node, tilted: bool, settled: Pose) -> tuple[Motions, Failure | None]:
        """Motions of transfer grasps that take the target up where it has settled."""
        grasps = self.graph.transfer_grasps(node, following, tilted)
        key = (grasps, settled.tobytes())
        if key not in self._pick_cache:
            self._pick_cache[key] = self.stages.plan_motions(
                stage_kind(node, following), [grasps.candidates], settled, self.stages.motion.pick_motions, keep=2
            )
        return self._pick_cache[key]

    def _solve_releases(
        self, kind: StageKind, candidates: Sequence[GraspCandidate], settled: Pose
    ) -> tuple[list[tuple[GraspCandidate, GraspIk]], Failure | None]:
        """Candidates with configurations at the release from which the target settles at one pose (7,)."""
        groups: dict[bytes, tuple[Pose, list[GraspCandidate]]] = {}
        for candidate in candidates:
            assert candidate.down is not None
            release = tilted_pose(settled, candidate.down, self._hull, self.options.motion.drop)
            groups.setdefault(release.tobytes(), (release, []))[1].append(candidate)
        solved: list[tuple[GraspCandidate, GraspIk]] = []
        failed: list[GraspIk] = []
        for key, (release, group) in groups.items():
            unknown = [candidate for candidate in group if (candidate, key) not in self._release_ik]
            answers = self.stages.grasp_ik([candidate.grasp for candidate in unknown], release) if unknown else []
            self._release_ik |= {(candidate, key): ik for candidate, ik in zip(unknown, answers, strict=True)}
            for candidate in group:
                ik = self._release_ik[candidate, key]
                if ik.configurations:
                    solved.append((candidate, ik))
                else:
                    failed.append(ik)
        return solved, None if solved else unreachable(self.task.target, kind, failed)


def _same_rotation(one: Pose, other: Pose) -> bool:
    return bool(abs(one[:4] @ other[:4]) > 1 - 1e-9)
