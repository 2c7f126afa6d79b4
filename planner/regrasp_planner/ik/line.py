"""Straight lines of the gripper: inverse kinematics from waypoint to waypoint of a line, on the host.

Each configuration starts from the one before, so this is plain NumPy: a compiled batch would be slower.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from regrasp_planner.pose import rigid
from regrasp_planner.robot.model import Arm

_STEP = 0.005
"""Metres between two configurations."""
_TURN = 0.02
"""Radians between two configurations."""
_TOLERANCE = 2e-5
"""Largest pose error on the line, metres and radians."""


class ArmKinematics:
    """Forward kinematics and Jacobian of the gripper frame for single configurations, in NumPy."""

    def __init__(self, arm: Arm):
        self.lower, self.upper = np.asarray(arm.lower, float), np.asarray(arm.upper, float)
        self._base, self._tool = rigid(np.asarray(arm.base)).as_matrix(), rigid(np.asarray(arm.tool)).as_matrix()
        self._origins = rigid(np.asarray(arm.origins)).as_matrix()
        self._axes = np.asarray(arm.axes, float)
        # Rodrigues' formula: once per joint and call, where scipy's rotations would take most of the time.
        self._cross = np.cross(np.eye(3), self._axes[:, None])
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
        configurations: (K, n) radians, from the start as far as the line could be followed.
        fraction: fraction of the line that could be followed.
        limiting_joint: index of the joint whose limit ended the line; None if the line is complete or out of reach.
    """

    configurations: Float[np.ndarray, "K n"]
    fraction: float
    limiting_joint: int | None


def follow_line(
    kinematics: ArmKinematics,
    start: Float[np.ndarray, " n"],
    displacement: Float[np.ndarray, 3],
    turn: Float[np.ndarray, 3] | None = None,
    coarse: bool = False,
) -> Line:
    """Move the gripper frame along a straight line from its pose at ``start``.

    Damped Newton steps of least joint motion. A joint at its limit stays there, and the others go on.

    Args:
        kinematics: kinematics of the arm.
        start: (n,) radians, within the limits.
        displacement: (3,) displacement of the gripper frame's origin, world axes, metres.
        turn: (3,) rotation vector in world axes applied evenly along the line; None keeps the orientation.
        coarse: take steps five times as long, for a rough line.
    """
    displacement = np.asarray(displacement, float)
    angle = 0.0 if turn is None else float(np.linalg.norm(turn))
    extent = max(float(np.linalg.norm(displacement)) / _STEP, angle / _TURN)
    count = int(np.ceil((extent / 5 if coarse else extent) - 1e-9))
    origin, _ = kinematics.gripper(start)
    steps = np.arange(1, count + 1)[:, None]
    goals = np.tile(origin, (count, 1, 1))
    goals[:, :3, 3] += displacement * steps / count
    if turn is not None:
        goals[:, :3, :3] = Rotation.from_rotvec(turn * steps / count).as_matrix() @ origin[:3, :3]
    q = np.asarray(start, float)
    out = [q]
    for k, goal in enumerate(goals):
        # Linear prediction from the last step halves the Newton steps.
        guess = q if len(out) < 2 else np.clip(2 * q - out[-2], kinematics.lower, kinematics.upper)
        solved, converged = _newton(kinematics, guess, goal)
        if not converged or np.abs(solved - q).max() > (0.6 if coarse else 0.2):
            at_limit = np.flatnonzero(np.minimum(solved - kinematics.lower, kinematics.upper - solved) < 1e-9)
            return Line(np.array(out), k / count, int(at_limit[0]) if len(at_limit) else None)
        q = solved
        out.append(q)
    return Line(np.array(out), 1.0, None)


def _newton(
    kinematics: ArmKinematics, guess: Float[np.ndarray, " n"], goal: Float[np.ndarray, "4 4"]
) -> tuple[Float[np.ndarray, " n"], bool]:
    """The configuration near the guess whose gripper pose is the goal, and whether the iteration converged."""
    q = guess
    for _ in range(12):
        pose, jacobian = kinematics.gripper(q)
        error = np.concatenate([goal[:3, 3] - pose[:3, 3], _rotation_vector(goal[:3, :3] @ pose[:3, :3].T)])
        if np.abs(error).max() < _TOLERANCE:
            return q, True
        step = _damped_step(jacobian, error)
        # Joints that the step would push beyond a limit stop there, and the step of the others is solved again, once.
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


def _rotation_vector(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, 3]:
    """Logarithm of a rotation by less than π/2: its skew part times angle / sin(angle).

    Once per Newton step, where scipy's logarithm would take a good part of the time.
    """
    skew = 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    sine = float(np.linalg.norm(skew))
    return skew * (np.arcsin(min(sine, 1.0)) / sine) if sine > 1e-9 else skew
