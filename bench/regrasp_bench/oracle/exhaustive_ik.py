"""Inverse kinematics of the oracle: exhaustive rather than quick, and independent of the planner's.

Tens of thousands of random configurations are made once. For a gripper pose, damped least squares in NumPy starts from
those whose gripper is nearest, and so from many elbows and wrists. Coal checks the solutions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from regrasp_bench.oracle.antipodal import GripperShapes
from regrasp_bench.peers.coal_shapes import PosedShapes, Shape, keeps_margins
from regrasp_planner import Robot

_RADIAN = 0.25
"""Length that weighs as much as a radian, metres."""


@dataclass(frozen=True)
class ExhaustiveIkOptions:
    """Effort of the inverse kinematics.

    Attributes:
        bank: number of random configurations to start from.
        starts: number of these per gripper pose.
        iterations: iterations of damped least squares.
        accuracy: largest error of a solution, metres; radians count as a quarter of a metre each.
        margin: margin of the arm from obstacles, metres.
    """

    bank: int = 40000
    starts: int = 16
    iterations: int = 25
    accuracy: float = 1e-4
    margin: float = 0.003


class ExhaustiveIk:
    """Kinematics of an arm, forward and inverse, and its shapes for collision checks.

    Args:
        robot: the robot.
        options: see `ExhaustiveIkOptions`.
    """

    def __init__(self, robot: Robot, options: ExhaustiveIkOptions | None = None) -> None:
        self.options = options or ExhaustiveIkOptions()
        arm = robot.arm
        self.lower, self.upper = np.asarray(arm.lower), np.asarray(arm.upper)
        self._axes = np.asarray(arm.axes)
        self._origins = [_matrix(pose) for pose in np.asarray(arm.origins)]
        self._base, self._tool = _matrix(np.asarray(arm.base)), _matrix(np.asarray(arm.tool))
        self.gripper = GripperShapes(robot.gripper)
        self.links = [Shape.of(robot.links[i]) for i in range(robot.links.batch_size)]
        self.link_of = np.asarray(robot.link_of)
        self._self_pairs = np.asarray(robot.self_pairs)
        rng = np.random.default_rng(0)
        q = rng.uniform(self.lower, self.upper, (self.options.bank, len(self.lower)))
        rotations, positions = self.forward(q)
        self._bank = q
        self._tree = KDTree(_features(rotations[:, -1], positions[:, -1]))

    def forward(
        self, q: Float[np.ndarray, "N n"]
    ) -> tuple[Float[np.ndarray, "N n+2 3 3"], Float[np.ndarray, "N n+2 3"]]:
        """Frames of links 0…n and of the gripper in the world."""
        count = len(q)
        turn, shift = np.tile(self._base[0], (count, 1, 1)), np.tile(self._base[1], (count, 1))
        turns, shifts = [turn], [shift]
        for (origin_turn, origin_shift), axis, angle in zip(self._origins, self._axes, q.T, strict=True):
            shift = shift + turn @ origin_shift
            turn = turn @ (origin_turn @ _about(axis, angle))
            turns.append(turn)
            shifts.append(shift)
        turns.append(turn @ self._tool[0])
        shifts.append(shift + turn @ self._tool[1])
        return np.stack(turns, 1), np.stack(shifts, 1)

    def nearest(
        self, rotations: Float[np.ndarray, "K 3 3"], positions: Float[np.ndarray, "K 3"]
    ) -> Int[np.ndarray, "K S"]:
        """Rows of the bank whose grippers are nearest."""
        return np.asarray(self._tree.query(_features(rotations, positions), self.options.starts)[1])

    def solve(
        self, rotations: Float[np.ndarray, "K 3 3"], positions: Float[np.ndarray, "K 3"]
    ) -> tuple[Float[np.ndarray, "L n"], Int[np.ndarray, " L"]]:
        """Configurations with the gripper at K poses, and the number of the pose of each."""
        q = self._bank[self.nearest(rotations, positions)].reshape(-1, len(self.lower))
        owner = np.repeat(np.arange(len(positions)), self.options.starts)
        q, reached = self.descend(q, rotations[owner], positions[owner], self.options.iterations)
        return q[reached], owner[reached]

    def descend(
        self, q: Float[np.ndarray, "L n"], rotations: np.ndarray, positions: np.ndarray, iterations: int
    ) -> tuple[Float[np.ndarray, "L n"], Bool[np.ndarray, " L"]]:
        """Damped least squares from each configuration towards its own pose; the results, and which are at the pose."""
        q = np.clip(q, self.lower, self.upper)
        reached = np.zeros(len(q), bool)
        going = np.arange(len(q))
        for _ in range(iterations + 1):
            turns, shifts = self.forward(q[going])
            error = _error(turns[:, -1], shifts[:, -1], rotations[going], positions[going])
            size = np.linalg.norm(error, axis=1)
            done = size < self.options.accuracy
            reached[going[done]] = True
            rest = ~done
            going, error, turns, shifts = going[rest], error[rest], turns[rest], shifts[rest]
            if len(going) == 0:
                break
            q[going] = self._step(q[going], error, size[rest], turns, shifts)
        return q, reached

    def _step(
        self, q: np.ndarray, error: np.ndarray, size: np.ndarray, turns: np.ndarray, shifts: np.ndarray
    ) -> np.ndarray:
        axes = (turns[:, 1:-1] @ self._axes[..., None])[..., 0]
        jacobian = np.concatenate([np.cross(axes, shifts[:, -1:] - shifts[:, 1:-1]), _RADIAN * axes], axis=2)
        jacobian = np.swapaxes(jacobian, 1, 2)
        slope = (error[:, None] @ jacobian)[:, 0]
        held = ((q <= self.lower) & (slope < 0)) | ((q >= self.upper) & (slope > 0))
        jacobian = np.where(held[:, None], 0.0, jacobian)
        square = jacobian @ np.swapaxes(jacobian, 1, 2) + (1e-9 + 0.1 * size**2)[:, None, None] * np.eye(6)
        move = (np.swapaxes(jacobian, 1, 2) @ np.linalg.solve(square, error[..., None]))[..., 0]
        move /= np.maximum(1.0, np.abs(move).max(1, keepdims=True))
        return np.clip(q + move, self.lower, self.upper)

    def arm(self, q: Float[np.ndarray, "N n"]) -> PosedShapes:
        """The bodies on the moving links, in N configurations."""
        turns, shifts = self.forward(q)
        moving = self.link_of > 0
        shapes = [shape for shape, moves in zip(self.links, moving, strict=True) if moves]
        return PosedShapes(shapes, turns[:, self.link_of[moving]], shifts[:, self.link_of[moving]])

    def self_free(self, q: Float[np.ndarray, "N n"], thetas: Float[np.ndarray, " N"]) -> Bool[np.ndarray, " N"]:
        """Which configurations keep the robot clear of itself."""
        turns, shifts = self.forward(q)
        gripper = self.gripper.at(turns[:, -1], shifts[:, -1], thetas)
        whole = PosedShapes(
            [*self.links, *gripper.shapes],
            np.concatenate([turns[:, self.link_of], gripper.rotations], 1),
            np.concatenate([shifts[:, self.link_of], gripper.positions], 1),
        )
        return keeps_margins(whole, whole, 0.0, self._self_pairs)


def _matrix(pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return Rotation.from_quat(pose[:4], scalar_first=True).as_matrix(), pose[4:]


def _about(axis: np.ndarray, angle: np.ndarray) -> Float[np.ndarray, "N 3 3"]:
    """Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + sine * cross + (1 - cosine) * (cross @ cross)


def _error(turn: np.ndarray, shift: np.ndarray, goal_turn: np.ndarray, goal_shift: np.ndarray) -> np.ndarray:
    """(L, 6) translation and scaled rotation vector, world axes, that bring a frame to its goal."""
    rotation = Rotation.from_matrix(goal_turn @ np.swapaxes(turn, 1, 2)).as_rotvec()
    return np.concatenate([goal_shift - shift, _RADIAN * rotation], axis=1)


def _features(rotations: np.ndarray, positions: np.ndarray) -> Float[np.ndarray, "N 12"]:
    # The distance of two rotation matrices is √2 times their angle if that is small.
    return np.concatenate([positions, _RADIAN / np.sqrt(2) * rotations.reshape(len(rotations), 9)], axis=1)
