"""Regrasps: the target is put down on one of its stable sides, once or several times, and taken again another way.

A chain start → k₁ → … → kₙ → goal leads over stable poses k. Each link is one grasp that is feasible at both its ends:
pick and k₁, kᵢ and kᵢ₊₁, kₙ and place (eq. (3)). Whether there are such grasps is found out first, link by link, and
kept; motion is planned only for chains all of whose links have them, the shortest and most stable ones first.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, permutations

import numpy as np
from jaxtyping import Float, Int

from regrasp_planner.grasp.reachability import ReachabilityGrader
from regrasp_planner.placement.basins import ReleaseCone, release_cones
from regrasp_planner.placement.release_pose import resting_poses, tilted_pose
from regrasp_planner.placement.stab_pose import stable_poses
from regrasp_planner.pose import Pose
from regrasp_planner.stages.plan import Failure, Reason, Stage, StageKind
from regrasp_planner.stages.search import Held, StageSearch, furthest
from regrasp_planner.stages.surroundings import Ends
from regrasp_planner.task import Scene

Links = tuple[list[Held], Failure | None]
"""Grasps of one link of a chain, and why there are none or no more."""


@dataclass(frozen=True)
class _Rest:
    """A stable pose: the ground under it with and without tilt, where the target can stand so, and whether the arm can
    take a grasp in any of these poses."""

    upright: ReleaseCone
    tilted: ReleaseCone
    poses: tuple[Pose, ...]
    reachable: ReachabilityGrader


class RegraspSearch:
    """Searches chains of stages over the stable poses of the target.

    Args:
        stages: what the stages have in common.
    """

    def __init__(self, stages: StageSearch) -> None:
        self.stages, self.task, self.options = stages, stages.task, stages.options
        self._hull = self.task.target.hull_vertices()
        effort = self.options.regrasp
        self._to_release = stages.search(effort, self.task.pick)
        self._to_place = stages.search(effort, self.task.place)
        self._on_ground = stages.search(effort)
        self._links: dict[tuple[int | None, int | None, bool], Links] = {}
        self._taken: dict[tuple[tuple[int, int | None], bool, bytes], Links] = {}
        self._laid: dict[tuple[int, bytes], Ends] = {}
        self._rests = self._stable()

    def _stable(self) -> tuple[_Rest, ...]:
        """Stable poses that fit the release area, those first that stand up to being let go, most stable first."""
        target, area = self.task.target, self.task.release
        poses = self.stages.clock.time("stab_pose", lambda: stable_poses(self._hull, target.center_of_mass))
        cones = release_cones(poses)
        order = sorted(range(len(poses)), key=lambda k: cones[k].half_angle <= 0)
        rests: list[_Rest] = []
        for k in order:
            where = resting_poses(area, self._hull, poses.rotations[k], self.options.yaws, self.options.spots)
            if where:
                upright = ReleaseCone(cones[k].axis, 0.0)
                rests.append(_Rest(upright, cones[k], tuple(where), partial(self._anywhere, tuple(where))))
        return tuple(rests[: self.options.max_stable_poses])

    def _anywhere(self, where: Sequence[Pose], grippers: Float[np.ndarray, "K 7"]) -> Int[np.ndarray, " K"]:
        """Whether the arm takes grasps in any of several poses on free ground; see `GraspSearch`."""
        grades = np.zeros(len(grippers), int)
        for pose in where:
            left = np.flatnonzero(grades == 0)
            if len(left):
                grades[left] = self.stages.looked(pose, grippers[left], collisions=False)
        return grades

    def once(self, tilted: bool) -> tuple[Stage, ...] | Failure:
        """One regrasp; the target let go in its stable pose, or where ``tilted``, to settle into it."""
        return self._first(((k,) for k in range(len(self._rests))), tilted, len(self._rests))

    def repeated(self) -> tuple[Stage, ...] | Failure:
        """Several regrasps, each on another side of the target."""
        outcome: tuple[Stage, ...] | Failure = self._no_rest()
        for length in range(2, self.options.max_stages):
            orders = sorted(permutations(range(len(self._rests)), length), key=lambda chain: (sum(chain), chain))
            outcome = self._first(iter(orders), True, self.options.chains)
            if not isinstance(outcome, Failure):
                break
        return outcome

    # --- chains -------------------------------------------------------------------------------------------------------

    def _first(self, chains: Iterator[tuple[int, ...]], tilted: bool, limit: int) -> tuple[Stage, ...] | Failure:
        """The stages of the first chain that works, of at most ``limit`` chains that have grasps for all links."""
        failure: Failure | None = None
        tried = 0
        for chain in chains:
            lacking = self._lacking(chain, tilted)
            if lacking is not None:
                failure = furthest(failure, lacking)
                continue
            outcome = self._follow(chain, tilted)
            if not isinstance(outcome, Failure):
                return outcome
            failure = furthest(failure, outcome)
            tried += 1
            if tried == limit:
                break
        return failure or self._no_rest()

    def _lacking(self, chain: tuple[int, ...], tilted: bool) -> Failure | None:
        """Why one of the links of the chain has no grasp; None if all have."""
        for link in ((chain[-1], None), (None, chain[0]), *pairwise(chain)):
            grasps, failure = self._link(*link, tilted)
            if not grasps:
                assert failure is not None
                return failure
        return None

    def _follow(self, chain: tuple[int, ...], tilted: bool) -> tuple[Stage, ...] | Failure:
        """Motion for the whole chain."""
        holding, _ = self._link(None, chain[0], tilted)
        return self._onward(chain, 0, tilted, holding, self.task.pick.target_pose, np.asarray(self.task.start))

    def _onward(
        self,
        chain: tuple[int, ...],
        done: int,
        tilted: bool,
        holding: Sequence[Held],
        pose: Pose,
        configuration: Float[np.ndarray, " n"],
    ) -> tuple[Stage, ...] | Failure:
        """The stages from the target standing at ``pose``, where it can be taken by the grasps ``holding``."""
        if done == len(chain):
            return self._to_goal(chain, tilted, holding, pose, configuration)
        kind = StageKind.REGRASP_TO_RELEASE if done else StageKind.PICK_TO_RELEASE
        following = StageKind.REGRASP_TO_PLACE if done + 1 == len(chain) else StageKind.REGRASP_TO_RELEASE
        link = (chain[done], None) if done + 1 == len(chain) else (chain[done], chain[done + 1])
        failure: Failure | None = None
        tried = 0
        onward, _ = self._link(*link, tilted)
        for settled in self._places(chain[done], holding, onward):
            laying, lacking = self._laying(kind, holding, settled)
            retaken: list[Held] = []
            if laying:
                retaken, lacking = self._retaken(following, link, tilted, settled)
            if not retaken:
                failure = furthest(failure, lacking or self.stages.unreachable(following))
                continue
            laid = False
            for stage in self._laid_down(kind, laying, pose, settled, configuration):
                if isinstance(stage, Failure):
                    failure = furthest(failure, stage)
                    continue
                laid = True
                rest = self._onward(chain, done + 1, tilted, retaken, settled, stage.end)
                if not isinstance(rest, Failure):
                    return (stage, *rest)
                failure = furthest(failure, rest)
                break
            tried += laid
            if tried == self.options.motion_attempts:
                break
        return failure or self.stages.unreachable(kind)

    def _places(self, k: int, holding: Sequence[Held], onward: Sequence[Held]) -> list[Pose]:
        """Where the target may stand in a stable pose, by a quick look at both its grasps; the best places first."""
        grippers = [np.array([held.grasp.pose for held in some]) for some in (holding, onward)]
        poses = self._rests[k].poses
        worth = [min(int(self.stages.looked(pose, some, False).max()) for some in grippers) for pose in poses]
        return [poses[i] for i in sorted(range(len(poses)), key=lambda i: -worth[i]) if worth[i]]

    def _retaken(self, kind: StageKind, link: tuple[int, int | None], tilted: bool, settled: Pose) -> Links:
        """Grasps of a link by which the target can be taken up where it has settled."""
        key = (link, tilted and link[1] is not None, settled.tobytes())
        if key not in self._taken:
            onward, _ = self._link(*link, tilted)
            self._taken[key] = self.stages.reached(kind, [onward], settled, self.stages.motion.takes, keep=2)
        return self._taken[key]

    def _laying(
        self, kind: StageKind, holding: Sequence[Held], settled: Pose
    ) -> tuple[list[tuple[Held, Pose, Ends]], Failure | None]:
        """Grasps by which the arm can hold the target where it is let go to settle at ``settled``."""
        groups: dict[bytes, tuple[Pose, list[Held]]] = {}
        for held in holding:
            assert held.down is not None
            release = tilted_pose(settled, held.down, self._hull, self.options.motion.drop)
            groups.setdefault(release.tobytes(), (release, []))[1].append(held)
        laying: list[tuple[Held, Pose, Ends]] = []
        lacking: list[Ends] = []
        for release, some in groups.values():
            unknown = [held for held in some if (id(held.grasp), release.tobytes()) not in self._laid]
            answers = self.stages.ends([held.grasp for held in unknown], release) if unknown else []
            for held, ends in zip(unknown, answers, strict=True):
                self._laid[id(held.grasp), release.tobytes()] = ends
            for held in some:
                ends = self._laid[id(held.grasp), release.tobytes()]
                if ends.configurations:
                    laying.append((held, release, ends))
                else:
                    lacking.append(ends)
        return laying, None if laying else self.stages.unreachable(kind, lacking)

    def _laid_down(
        self,
        kind: StageKind,
        laying: Sequence[tuple[Held, Pose, Ends]],
        pose: Pose,
        settled: Pose,
        configuration: Float[np.ndarray, " n"],
    ) -> Iterator[Stage | Failure]:
        """Stages that take the target from ``pose`` and let it go so that it settles at ``settled``."""
        motion = self.stages.motion
        for held, release, ends in laying:
            assert held.reaches is not None
            puts = motion.puts(kind, held.grasp, release, ends, wide=not _same_turn(release, settled))
            yield motion.join(kind, held.grasp, pose, release, settled, held.reaches, puts, configuration)

    def _to_goal(
        self,
        chain: tuple[int, ...],
        tilted: bool,
        holding: Sequence[Held],
        pose: Pose,
        configuration: Float[np.ndarray, " n"],
    ) -> tuple[Stage, ...] | Failure:
        placing, _ = self._link(chain[-1], None, tilted)
        putting = {id(held.grasp): held.reaches for held in placing}
        failure: Failure | None = None
        for held in holding:
            puts = putting[id(held.grasp)]
            assert held.reaches is not None
            assert puts is not None
            stage = self.stages.motion.join(
                StageKind.REGRASP_TO_PLACE,
                held.grasp,
                pose,
                self.stages.goal,
                self.task.place.target_pose,
                held.reaches,
                puts,
                configuration,
            )
            if isinstance(stage, Stage):
                return (stage,)
            failure = furthest(failure, stage)
        return failure or self.stages.unreachable(StageKind.REGRASP_TO_PLACE)

    # --- links --------------------------------------------------------------------------------------------------------

    def _link(self, begin: int | None, end: int | None, tilted: bool) -> Links:
        """Grasps from stable pose ``begin`` (None: the pick) to ``end`` (None: the goal)."""
        key = (begin, end, tilted and end is not None)
        if key not in self._links:
            self._links[key] = self._linked(begin, end, tilted)
        return self._links[key]

    def _linked(self, begin: int | None, end: int | None, tilted: bool) -> Links:
        stages, motion = self.stages, self.stages.motion
        also = [self._rests[k].reachable for k in (begin, end) if k is not None]
        start = None if begin is None else self._rests[begin].upright
        ground = None if end is None else self._rests[end].tilted if tilted else self._rests[end].upright
        if begin is None:
            kind, search, scene = StageKind.PICK_TO_RELEASE, self._to_release, self.task.pick
            pose, find = scene.target_pose, motion.takes
        elif end is None:
            kind, search, scene = StageKind.REGRASP_TO_PLACE, self._to_place, self.task.place
            pose, find = stages.goal, motion.puts
        else:
            kind, search = StageKind.REGRASP_TO_RELEASE, self._on_ground
            batches = stages.either_way(search.grasps(start, ground, also))
            grasps: list[Held] = []
            for batch in batches:
                grasps += batch
                if len(grasps) >= 2 * self.options.grasps_kept:
                    break
            return grasps, None if grasps else stages.no_grasp(kind, search, "both stable poses")
        found, failure = stages.reached(kind, stages.either_way(search.grasps(start, ground, also)), pose, find)
        if not found and failure is None:
            failure = stages.no_grasp(kind, search, self._between(scene, search.any_feasible))
        if ground is not None:
            found.sort(key=lambda held: 0.0 if held.down is None else float(np.round(-held.down @ ground.axis, 3)))
        return found, failure

    @staticmethod
    def _between(scene: Scene, elsewhere: bool) -> str:
        return f"{scene.name} and release" if elsewhere else scene.name

    def _no_rest(self) -> Failure:
        name = self.task.target.name
        return Failure(
            Reason.NO_STABLE_POSE,
            StageKind.PICK_TO_RELEASE,
            "stable pose",
            f"{name!r} rests in no pose that fits the release area and from which it can be taken on",
        )


def _same_turn(one: Pose, other: Pose) -> bool:
    return bool(abs(one[:4] @ other[:4]) > 1 - 1e-9)
