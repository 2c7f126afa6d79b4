"""Straight lines of the gripper: inverse kinematics continued along a line with fixed orientation, on the host.

One configuration at a time, so plain NumPy: a compiled batch would be slower here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from regrasp_planner.robot.model import Arm

_STEP = 0.005
"""Length of line between two solved configurations, metres."""
_TURN = 0.02
"""Turn between two solved configurations, radians."""
_TOLERANCE = 2e-5
"""Pose error that counts as on the line (metres, and radians)."""


class ArmKinematics:
    """Forward kinematics and Jacobian of the gripper frame for single configurations, in NumPy."""

    def __init__(self, arm: Arm):
        self.lower, self.upper = np.asarray(arm.lower, float), np.asarray(arm.upper, float)
        self._base = _matrix(np.asarray(arm.base, float))
        self._tool = _matrix(np.asarray(arm.tool, float))
        self._origins = [_matrix(pose) for pose in np.asarray(arm.origins, float)]
        self._axes = np.asarray(arm.axes, float)
        self._cross = np.stack([_cross_matrix(axis) for axis in self._axes])
        self._cross_squared = self._cross @ self._cross

    def gripper(self, q: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "6 n"]]:
        """Homogeneous pose of the gripper frame in the world, and its Jacobian (linear rows first, world axes)."""
        pose = self._base
        axes, points = [], []
        for i, origin in enumerate(self._origins):
            pose = pose @ origin
            axes.append(pose[:3, :3] @ self._axes[i])
            points.append(pose[:3, 3])
            turn = np.eye(4)
            turn[:3, :3] += np.sin(q[i]) * self._cross[i] + (1 - np.cos(q[i])) * self._cross_squared[i]
            pose = pose @ turn
        pose = pose @ self._tool
        axis, point = np.array(axes), np.array(points)
        return pose, np.concatenate([np.cross(axis, pose[:3, 3] - point), axis], axis=1).T


@dataclass(frozen=True)
class Line:
    """Configurations along a line of the gripper.

    Attributes:
        configurations: (K, n) radians, the start first; as far as the line could be followed.
        fraction: share of the line that could be followed; 1 if all of it.
        limited: index of the joint whose limit ended it, or None (then the arm does not reach further).
    """

    configurations: Float[np.ndarray, "K n"]
    fraction: float
    limited: int | None


def follow_line(
    kinematics: ArmKinematics,
    start: Float[np.ndarray, " n"],
    displacement: Float[np.ndarray, 3],
    turn: Float[np.ndarray, 3] | None = None,
    coarse: bool = False,
) -> Line:
    """Move the gripper frame along a straight line from where it is at ``start``.

    Damped Newton steps of least joint motion; a joint that reaches a limit stays there and the others go on.

    Args:
        kinematics: of the arm.
        start: (n,) radians, within limits.
        displacement: (3,) of the gripper frame's origin, world axes, metres.
        turn: (3,) rotation vector in world axes applied evenly along the line; None keeps the orientation.
        coarse: five times longer steps, for a rough idea of where the line leads.
    """
    displacement = np.asarray(displacement, float)
    turn = np.zeros(3) if turn is None else np.asarray(turn, float)
    extent = max(float(np.linalg.norm(displacement)) / _STEP, float(np.linalg.norm(turn)) / _TURN)
    count = int(np.ceil((extent / 5 if coarse else extent) - 1e-9))
    origin, _ = kinematics.gripper(start)
    q = np.asarray(start, float)
    out = [q]
    for k in range(1, count + 1):
        goal = origin.copy()
        goal[:3, 3] += displacement * k / count
        goal[:3, :3] = _rotation(turn * k / count) @ origin[:3, :3]
        # Linear prediction from the last step halves the Newton steps.
        guess = q if len(out) < 2 else np.clip(2 * q - out[-2], kinematics.lower, kinematics.upper)
        solved, reached = _newton(kinematics, guess, goal)
        if not reached or np.abs(solved - q).max() > (0.6 if coarse else 0.2):
            at_limit = np.flatnonzero(np.minimum(solved - kinematics.lower, kinematics.upper - solved) < 1e-9)
            return Line(np.array(out), (k - 1) / count, int(at_limit[0]) if len(at_limit) else None)
        q = solved
        out.append(q)
    return Line(np.array(out), 1.0, None)


def _newton(
    kinematics: ArmKinematics, guess: Float[np.ndarray, " n"], goal: Float[np.ndarray, "4 4"]
) -> tuple[Float[np.ndarray, " n"], bool]:
    """Configuration near the guess whose gripper pose is the goal; false with the last iterate if there is none."""
    q = guess
    for _ in range(12):
        pose, jacobian = kinematics.gripper(q)
        error = np.concatenate([goal[:3, 3] - pose[:3, 3], _rotation_vector(goal[:3, :3] @ pose[:3, :3].T)])
        if np.abs(error).max() < _TOLERANCE:
            return q, True
        step = _damped_step(jacobian, error)
        # Joints that the step would push through their limit are taken out, once; then the rest solves again.
        blocked = (q + step > kinematics.upper + 1e-12) | (q + step < kinematics.lower - 1e-12)
        if blocked.any():
            stop = np.clip(q + step, kinematics.lower, kinematics.upper) - q
            rest = np.where(blocked, 0.0, 1.0) * jacobian
            step = np.where(blocked, stop, _damped_step(rest, error - jacobian[:, blocked] @ stop[blocked]))
        q = np.clip(q + step, kinematics.lower, kinematics.upper)
    return q, False


def _damped_step(jacobian: Float[np.ndarray, "6 n"], error: Float[np.ndarray, 6]) -> Float[np.ndarray, " n"]:
    step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-8 * np.eye(6), error)
    longest = np.abs(step).max()
    return step * min(1.0, 0.2 / longest) if longest > 0 else step


def _matrix(pose: Float[np.ndarray, 7]) -> Float[np.ndarray, "4 4"]:
    w, x, y, z = pose[:4] / np.linalg.norm(pose[:4])
    cross = _cross_matrix(np.array([x, y, z]))
    out = np.eye(4)
    out[:3, :3] += 2 * w * cross + 2 * cross @ cross
    out[:3, 3] = pose[4:]
    return out


def _cross_matrix(v: Float[np.ndarray, 3]) -> Float[np.ndarray, "3 3"]:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _rotation(vector: Float[np.ndarray, 3]) -> Float[np.ndarray, "3 3"]:
    """exp of a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    cross = _cross_matrix(vector)
    # sinc keeps both factors finite at zero.
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * cross @ cross


def _rotation_vector(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, 3]:
    """log of a rotation by less than π/2: the skew part, exact up to the factor angle / sin(angle)."""
    skew = 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    sine = float(np.linalg.norm(skew))
    return skew * (np.arcsin(min(sine, 1.0)) / sine) if sine > 1e-9 else skew
