"""In which scenes one grasp is enough: an exhaustive search that is not the planner, to set the difficulty by.

Every grasp of a dense grid (`sample_grasps`) is checked exactly against the obstacles of both scenes, and inverse
kinematics from many starts says which of those left the arm can reach, clear of everything, at either end.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from regrasp_bench.oracle.antipodal import AntipodalOptions, Candidates, sample_grasps
from regrasp_bench.oracle.reach import Reach, ReachOptions
from regrasp_bench.peers.coal_shapes import Posed, Shape, clear
from regrasp_planner import Body, Robot, Task
from regrasp_planner.stages.scale import planner_scale, scaled_robot, scaled_task
from regrasp_planner.task import Obstacle

_WAYPOINTS = 3
"""Points checked on a straight line."""

_JUMP = 0.8
"""Largest turn of a joint (radians) between two of them that still counts as following the line."""


@dataclass(frozen=True)
class OracleOptions:
    """Effort and margins of the oracle.

    Attributes:
        grasps: how densely grasps are sampled.
        reach: effort of the inverse kinematics.
        batch: grasps whose inverse kinematics is solved together.
        tried: most grasps, of those free of collision, whose inverse kinematics is solved for one answer.
        retreat: least straight line of the open gripper off the target, metres.
        lift, lower: least height by which the held target is lifted off, and lowered from, metres.
        slack: share of the opening by which a grasp may fall short of its margin, as GraspGen allows.
        margin_held: of the held target from obstacles at the upper end of these lines, metres.
        lines: configurations per grasp whose straight lines are tried.
    """

    grasps: AntipodalOptions = field(default_factory=AntipodalOptions)
    reach: ReachOptions = field(default_factory=ReachOptions)
    batch: int = 32
    tried: int = 100_000
    retreat: float = 0.06
    lift: float = 0.03
    lower: float = 0.015
    slack: float = 0.01
    margin_held: float = 0.005
    lines: int = 6


class Use(IntEnum):
    """What can be done with the best of some grasps."""

    NONE = 0
    """Nothing: each is in collision, or no configuration of the arm without collision has the gripper there."""
    REACHED = 1
    """Some configuration of the arm without collision has the gripper there."""
    MOVED = 2
    """From such a configuration, straight lines lead off the target, and up with the target held."""


class Verdict(NamedTuple):
    """What the oracle says of a task.

    Attributes:
        pick: of the best grasp at the start.
        goal: of the best grasp at the goal.
        both: of the best grasp for both: the lesser of its two uses.
        pick_grasps, goal_grasps, common_grasps: grasps of the grid that are free of collision, the arm left aside.
    """

    pick: Use
    goal: Use
    both: Use
    pick_grasps: int
    goal_grasps: int
    common_grasps: int


class Oracle:
    """Judges tasks for one robot. What depends on the target alone is kept for the next task with it.

    As the planner does, it works at the size at which the gripper opens 80 mm: its lengths are for that.
    """

    def __init__(self, robot: Robot, options: OracleOptions | None = None) -> None:
        self.options = options or OracleOptions()
        self._factor = planner_scale(robot)
        robot = scaled_robot(robot, self._factor)
        self.reach = Reach(robot, self.options.reach)
        self.clearance = (self.options.grasps.margin - self.options.slack) * float(robot.gripper.max_opening)
        self.approach_axis = np.asarray(robot.gripper.approach_axis)
        self._robot = robot
        self._candidates: dict[bytes, Candidates] = {}

    def judge(self, task: Task) -> Verdict:
        """What can be done with one grasp; stops as soon as it is known."""
        task = scaled_task(task, self._factor)
        shape = task.target.hull_vertices().tobytes()
        if shape not in self._candidates:
            self._candidates[shape] = sample_grasps(task.target, self._robot.gripper, self.options.grasps)
        grasps = self._candidates[shape]
        ends = [
            _End(self, grasps, task.target, scene.target_pose, scene.obstacles, height)
            for scene, height in ((task.pick, self.options.lift), (task.place, self.options.lower))
        ]
        pick, goal = ends
        common = np.intersect1d(pick.free, goal.free)
        both = Use.NONE
        for batch in self._batches(common):
            at_goal = goal.uses(batch)
            better = at_goal > both
            uses = np.minimum(at_goal[better], pick.uses(batch[better]))
            both = Use(max([both, *uses.tolist()]))
            if both is Use.MOVED:
                break
        return Verdict(
            self._best(pick, both), self._best(goal, both), both, len(pick.free), len(goal.free), len(common)
        )

    def _best(self, end: _End, known: Use) -> Use:
        best = known
        for batch in self._batches(end.free):
            if best is Use.MOVED:
                break
            best = Use(max([best, *end.uses(batch).tolist()]))
        return best

    def _batches(self, grasps: Int[np.ndarray, " N"]) -> Iterator[Int[np.ndarray, " B"]]:
        """The grasps with the fingers either way round (2k and 2k + 1), shuffled, batch by batch."""
        both = np.concatenate([2 * grasps, 2 * grasps + 1])
        mixed = np.random.default_rng(0).permutation(both)
        for begin in range(0, min(len(mixed), self.options.tried), self.options.batch):
            yield mixed[begin : begin + self.options.batch]


class _End:
    """The target standing at one pose: which grasps of it are free, and which of these the arm can use."""

    def __init__(
        self,
        oracle: Oracle,
        grasps: Candidates,
        target: Body,
        pose: Float[np.ndarray, " 7"],
        obstacles: Sequence[Obstacle],
        height: float,
    ) -> None:
        self.oracle, self.grasps, self.height = oracle, grasps, height
        self.turn, self.shift = Rotation.from_quat(pose[:4], scalar_first=True).as_matrix(), pose[4:]
        self.world = _posed(obstacles)
        pieces = [Shape.of(piece) for piece in target.pieces]
        self.target = Posed(pieces, np.tile(self.turn, (len(pieces), 1, 1)), np.tile(self.shift, (len(pieces), 1)))
        hand = oracle.reach.hand.at(
            self.turn @ grasps.rotations, grasps.positions @ self.turn.T + self.shift, grasps.openings
        )
        self.free = np.flatnonzero(clear(hand, self.world, oracle.clearance))
        self._known: dict[int, int] = {}

    def uses(self, grasps: Int[np.ndarray, " B"]) -> Int[np.ndarray, " B"]:
        """`Use` of each of the grasps (2k, or 2k + 1 with the fingers exchanged) here."""
        new = np.array([grasp for grasp in grasps if int(grasp) not in self._known], dtype=int)
        if len(new):
            self._known |= dict(zip(new.tolist(), self._judged(new).tolist(), strict=True))
        return np.array([self._known[int(grasp)] for grasp in grasps], dtype=int)

    def _judged(self, grasps: Int[np.ndarray, " B"]) -> Int[np.ndarray, " B"]:
        oracle = self.oracle
        uses = np.zeros(len(grasps), dtype=int)
        q, owner = oracle.reach.solve(*self._frames(grasps))
        free = self._arm_free(q, self.grasps.openings[grasps[owner] // 2])
        q, owner = q[free], owner[free]
        uses[owner] = Use.REACHED
        few = np.arange(len(owner)) - np.searchsorted(owner, owner) < oracle.options.lines
        q, owner = q[few], owner[few]
        uses[owner[self._straight(q, grasps[owner])]] = Use.MOVED
        return uses

    def _frames(self, grasps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gripper frames in the world."""
        rotations = self.turn @ self.grasps.rotations[grasps // 2]
        axis = self.oracle.approach_axis
        exchanged = rotations @ (2 * np.outer(axis, axis) - np.eye(3))
        rotations = np.where((grasps % 2 == 1)[:, None, None], exchanged, rotations)
        return rotations, self.grasps.positions[grasps // 2] @ self.turn.T + self.shift

    def _arm_free(self, q: np.ndarray, thetas: np.ndarray, *, held: bool = False) -> np.ndarray:
        """Which configurations keep the arm clear of the world, of the target unless it is held, and of itself."""
        margin = self.oracle.options.reach.margin
        free = clear(self.oracle.reach.arm(q), self.world, margin)
        if not held:
            free[free] = clear(self.oracle.reach.arm(q[free]), self.target, margin)
        free[free] = self.oracle.reach.self_free(q[free], thetas[free])
        return free

    def _straight(self, q: np.ndarray, grasps: np.ndarray) -> np.ndarray:
        """From which configurations the open gripper gets off the target, and the full one up, in straight lines."""
        options = self.oracle.options
        rotations, _ = self._frames(grasps)
        out = -rotations @ self.oracle.approach_axis
        level = out * [1.0, 1.0, 0.0]
        size = np.linalg.norm(level, axis=1, keepdims=True)
        level = np.where((size > 0.3) & (size < 0.98), level / np.maximum(size, 1e-9), out)
        up = self._line(q, grasps, np.tile([0.0, 0.0, self.height], (len(q), 1)), held=True)
        back = np.zeros(len(q), bool)
        for direction in (out, level):
            left = np.flatnonzero(up & ~back)
            back[left] = self._line(q[left], grasps[left], options.retreat * direction[left], held=False)
        return up & back

    def _line(self, q: np.ndarray, grasps: np.ndarray, displacements: np.ndarray, *, held: bool) -> np.ndarray:
        """Which configurations can follow their displacement, the gripper keeping its orientation."""
        options, reach = self.oracle.options, self.oracle.reach
        rotations, positions = self._frames(grasps)
        thetas = (self.grasps.thetas if held else self.grasps.openings)[grasps // 2]
        good = np.arange(len(q))
        for share in np.linspace(0, 1, _WAYPOINTS + 1)[1:]:
            goals = positions[good] + share * displacements[good]
            moved, reached = reach.descend(q[good], rotations[good], goals, 12)
            reached &= np.abs(moved - q[good]).max(1) < _JUMP
            hand = reach.hand.at(rotations[good], goals, thetas[good])
            reached[reached] = clear(hand.rows(reached), self.world, options.reach.margin)
            if not held:
                reached[reached] = clear(hand.rows(reached), self.target, options.grasps.finger_margin)
            reached[reached] = self._arm_free(moved[reached], thetas[good][reached], held=held)
            if held and share == 1:
                shifts = self.target.positions + (share * displacements[good])[:, None]
                target = Posed(self.target.shapes, np.tile(self.target.rotations, (len(good), 1, 1, 1)), shifts)
                reached[reached] = clear(target.rows(reached), self.world, options.margin_held)
            good = good[reached]
            q = q.copy()
            q[good] = moved[reached]
        result = np.zeros(len(q), bool)
        result[good] = True
        return result


def _posed(obstacles: Sequence[Obstacle]) -> Posed:
    shapes, turns, shifts = [], [], []
    for obstacle in obstacles:
        for piece in obstacle.body.pieces:
            shapes.append(Shape.of(piece))
            turns.append(Rotation.from_quat(obstacle.pose[:4], scalar_first=True).as_matrix())
            shifts.append(obstacle.pose[4:])
    return Posed(shapes, np.array(turns), np.array(shifts))
