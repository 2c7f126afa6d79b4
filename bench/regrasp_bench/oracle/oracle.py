"""In which scenes one grasp suffices: an exhaustive search, independent of the planner, that sets their difficulty.

Every grasp of a dense grid (`sample_grasps`) is checked exactly against the obstacles of both scenes. Inverse
kinematics from many starts tells which of the remaining grasps the arm can reach at either end, free of collisions.
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
from regrasp_bench.oracle.exhaustive_ik import ExhaustiveIk, ExhaustiveIkOptions
from regrasp_bench.peers.coal_shapes import PosedShapes, Shape, keeps_margins
from regrasp_planner import Body, Robot, Task
from regrasp_planner.stages.scale import planner_scale, scaled_robot, scaled_task
from regrasp_planner.task import Obstacle

_WAYPOINTS, _JUMP = 3, 0.8
"""Points checked on a straight line, and the largest turn of a joint between two of them, radians."""


@dataclass(frozen=True)
class LineOptions:
    """Straight lines to and from the target.

    Attributes:
        retreat: least length of the open gripper's line off the target, metres.
        lift, lower: least heights of the held target's lines, at the pick and at the place, metres.
        margin_held: margin of the held target from obstacles at the upper end of these lines, metres.
        configurations: number of configurations per grasp whose lines are tried.
    """

    retreat: float = 0.06
    lift: float = 0.03
    lower: float = 0.015
    margin_held: float = 0.005
    configurations: int = 6


@dataclass(frozen=True)
class OracleOptions:
    """Effort and margins of the oracle.

    Attributes:
        grasps: density of the grasps.
        ik: effort of the inverse kinematics.
        lines: straight lines to and from the target.
        batch: number of grasps whose inverse kinematics is solved together.
        tried: largest number of collision-free grasps whose inverse kinematics is solved for one answer.
        slack: share of the opening by which a grasp may violate its margin, as GraspGen allows.
    """

    grasps: AntipodalOptions = field(default_factory=AntipodalOptions)
    ik: ExhaustiveIkOptions = field(default_factory=ExhaustiveIkOptions)
    lines: LineOptions = field(default_factory=LineOptions)
    batch: int = 32
    tried: int = 100_000
    slack: float = 0.01


class GraspUse(IntEnum):
    """What the best of several grasps can be used for."""

    NONE = 0
    """Nothing: each collides, or no collision-free configuration of the arm has the gripper there."""
    REACHABLE = 1
    """Some collision-free configuration of the arm has the gripper there."""
    MOVABLE = 2
    """From such a configuration, straight lines lead off the target, and up with the held target."""


class Verdict(NamedTuple):
    """The oracle's answer for a task.

    Attributes:
        pick: use of the best grasp at the start.
        goal: use of the best grasp at the goal.
        both: use of the best grasp for both: the lesser of its two uses.
        pick_grasps, goal_grasps, common_grasps: number of grasps of the grid that are free of collisions, arm ignored.
    """

    pick: GraspUse
    goal: GraspUse
    both: GraspUse
    pick_grasps: int
    goal_grasps: int
    common_grasps: int


class Oracle:
    """Judges tasks for one robot. Candidates are kept per target.

    Like the planner, it scales the task so that the gripper opens 80 mm. Its lengths are for that size.
    """

    def __init__(self, robot: Robot, options: OracleOptions | None = None) -> None:
        self.options = options or OracleOptions()
        self._factor = planner_scale(robot)
        robot = scaled_robot(robot, self._factor)
        self.ik = ExhaustiveIk(robot, self.options.ik)
        self.clearance = (self.options.grasps.margin - self.options.slack) * float(robot.gripper.max_opening)
        self.approach_axis = np.asarray(robot.gripper.approach_axis)
        self._robot = robot
        self._candidates: dict[bytes, Candidates] = {}

    def judge(self, task: Task) -> Verdict:
        """What one grasp can be used for; stops as soon as that is known."""
        task = scaled_task(task, self._factor)
        shape = task.target.hull_vertices().tobytes()
        if shape not in self._candidates:
            self._candidates[shape] = sample_grasps(task.target, self._robot.gripper, self.options.grasps)
        grasps = self._candidates[shape]
        ends = [
            _TargetPose(self, grasps, task.target, scene.target_pose, scene.obstacles, height)
            for scene, height in ((task.pick, self.options.lines.lift), (task.place, self.options.lines.lower))
        ]
        pick, goal = ends
        common = np.intersect1d(pick.free, goal.free)
        both = GraspUse.NONE
        for batch in self._batches(common):
            at_goal = goal.uses(batch)
            better = at_goal > both
            uses = np.minimum(at_goal[better], pick.uses(batch[better]))
            both = GraspUse(max([both, *uses.tolist()]))
            if both is GraspUse.MOVABLE:
                break
        return Verdict(
            self._best(pick, both), self._best(goal, both), both, len(pick.free), len(goal.free), len(common)
        )

    def _best(self, at: _TargetPose, known: GraspUse) -> GraspUse:
        best = known
        for batch in self._batches(at.free):
            if best is GraspUse.MOVABLE:
                break
            best = GraspUse(max([best, *at.uses(batch).tolist()]))
        return best

    def _batches(self, grasps: Int[np.ndarray, " N"]) -> Iterator[Int[np.ndarray, " B"]]:
        """The grasps with the fingers either way round (2k and 2k + 1), shuffled, in batches."""
        both = np.concatenate([2 * grasps, 2 * grasps + 1])
        mixed = np.random.default_rng(0).permutation(both)
        for begin in range(0, min(len(mixed), self.options.tried), self.options.batch):
            yield mixed[begin : begin + self.options.batch]


class _TargetPose:
    """The target at one pose: which grasps of it are free of collisions, and which of these the arm can use."""

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
        self.target = PosedShapes(
            pieces, np.tile(self.turn, (len(pieces), 1, 1)), np.tile(self.shift, (len(pieces), 1))
        )
        gripper = oracle.ik.gripper.at(
            self.turn @ grasps.rotations, grasps.positions @ self.turn.T + self.shift, grasps.openings
        )
        self.free = np.flatnonzero(keeps_margins(gripper, self.world, oracle.clearance))
        self._known: dict[int, int] = {}

    def uses(self, grasps: Int[np.ndarray, " B"]) -> Int[np.ndarray, " B"]:
        """`GraspUse` of each of the grasps (2k, or 2k + 1 with the fingers exchanged) at this pose."""
        new = np.array([grasp for grasp in grasps if int(grasp) not in self._known], dtype=int)
        if len(new):
            self._known |= dict(zip(new.tolist(), self._judged(new).tolist(), strict=True))
        return np.array([self._known[int(grasp)] for grasp in grasps], dtype=int)

    def _judged(self, grasps: Int[np.ndarray, " B"]) -> Int[np.ndarray, " B"]:
        oracle = self.oracle
        uses = np.zeros(len(grasps), dtype=int)
        q, owner = oracle.ik.solve(*self._frames(grasps))
        free = self._arm_free(q, self.grasps.openings[grasps[owner] // 2])
        q, owner = q[free], owner[free]
        uses[owner] = GraspUse.REACHABLE
        few = np.arange(len(owner)) - np.searchsorted(owner, owner) < oracle.options.lines.configurations
        q, owner = q[few], owner[few]
        uses[owner[self._straight(q, grasps[owner])]] = GraspUse.MOVABLE
        return uses

    def _frames(self, grasps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gripper frames in the world."""
        rotations = self.turn @ self.grasps.rotations[grasps // 2]
        axis = self.oracle.approach_axis
        exchanged = rotations @ (2 * np.outer(axis, axis) - np.eye(3))
        rotations = np.where((grasps % 2 == 1)[:, None, None], exchanged, rotations)
        return rotations, self.grasps.positions[grasps // 2] @ self.turn.T + self.shift

    def _arm_free(self, q: np.ndarray, thetas: np.ndarray, *, held: bool = False) -> np.ndarray:
        """In which configurations the arm collides with neither the world, nor a target not held, nor itself."""
        margin = self.oracle.options.ik.margin
        free = keeps_margins(self.oracle.ik.arm(q), self.world, margin)
        if not held:
            free[free] = keeps_margins(self.oracle.ik.arm(q[free]), self.target, margin)
        free[free] = self.oracle.ik.self_free(q[free], thetas[free])
        return free

    def _straight(self, q: np.ndarray, grasps: np.ndarray) -> np.ndarray:
        """From which configurations straight lines lead the open gripper off the target, and the held target up."""
        retreat = self.oracle.options.lines.retreat
        rotations, _ = self._frames(grasps)
        out = -rotations @ self.oracle.approach_axis
        level = out * [1.0, 1.0, 0.0]
        size = np.linalg.norm(level, axis=1, keepdims=True)
        level = np.where((size > 0.3) & (size < 0.98), level / np.maximum(size, 1e-9), out)
        up = self._line(q, grasps, np.tile([0.0, 0.0, self.height], (len(q), 1)), held=True)
        back = np.zeros(len(q), bool)
        for direction in (out, level):
            left = np.flatnonzero(up & ~back)
            back[left] = self._line(q[left], grasps[left], retreat * direction[left], held=False)
        return up & back

    def _line(self, q: np.ndarray, grasps: np.ndarray, displacements: np.ndarray, *, held: bool) -> np.ndarray:
        """Which configurations can follow their displacements with the gripper's orientation kept."""
        options, ik = self.oracle.options, self.oracle.ik
        rotations, positions = self._frames(grasps)
        thetas = (self.grasps.thetas if held else self.grasps.openings)[grasps // 2]
        good = np.arange(len(q))
        for share in np.linspace(0, 1, _WAYPOINTS + 1)[1:]:
            goals = positions[good] + share * displacements[good]
            moved, followed = ik.descend(q[good], rotations[good], goals, 12)
            followed &= np.abs(moved - q[good]).max(1) < _JUMP
            gripper = ik.gripper.at(rotations[good], goals, thetas[good])
            followed[followed] = keeps_margins(gripper.rows(followed), self.world, options.ik.margin)
            if not held:
                followed[followed] = keeps_margins(gripper.rows(followed), self.target, options.grasps.finger_margin)
            followed[followed] = self._arm_free(moved[followed], thetas[good][followed], held=held)
            if held and share == 1:
                shifts = self.target.positions + (share * displacements[good])[:, None]
                target = PosedShapes(self.target.shapes, np.tile(self.target.rotations, (len(good), 1, 1, 1)), shifts)
                followed[followed] = keeps_margins(target.rows(followed), self.world, options.lines.margin_held)
            good = good[followed]
            q = q.copy()
            q[good] = moved[followed]
        result = np.zeros(len(q), bool)
        result[good] = True
        return result


def _posed(obstacles: Sequence[Obstacle]) -> PosedShapes:
    shapes, turns, shifts = [], [], []
    for obstacle in obstacles:
        for piece in obstacle.body.pieces:
            shapes.append(Shape.of(piece))
            turns.append(Rotation.from_quat(obstacle.pose[:4], scalar_first=True).as_matrix())
            shifts.append(obstacle.pose[4:])
    return PosedShapes(shapes, np.array(turns), np.array(shifts))
