"""From actions to commanded positions of the arm's joints and of the fingers.

A command is an array (n + 1,): joint positions in radians, then the finger coordinate θ (travel in metres for sliding
fingers, an angle in radians for jaws). Over the physics steps of one environment step, the actuators' set points move
in a straight line from the last command to the new one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np
from gymnasium import spaces
from jaxtyping import Float

from regrasp_gym.errors import ActionError


@dataclass(frozen=True, eq=False)
class CommandLimits:
    """Limits of commands and of their steps.

    Attributes:
        lower, upper: (n + 1,) least and greatest command.
        step: (n,) largest move of each joint's command in one environment step, radians.
    """

    lower: Float[np.ndarray, " n+1"]
    upper: Float[np.ndarray, " n+1"]
    step: Float[np.ndarray, " n"]

    def advance(self, command: Float[np.ndarray, " n+1"], wanted: Float[np.ndarray, " n+1"]) -> np.ndarray:
        """The command nearest to ``wanted`` on the straight line from ``command``, within limits and step.

        All joints slow down by the same factor, which keeps the path in joint space; θ is only clipped.
        """
        wanted = np.clip(wanted, self.lower, self.upper)
        move = wanted[:-1] - command[:-1]
        slow = max(1.0, float((np.abs(move) / self.step).max()))
        return np.append(command[:-1] + move / slow, wanted[-1])


class Control(Protocol):
    """A control mode: how actions become commands."""

    @property
    def action_space(self) -> spaces.Box:
        """The space of actions."""
        ...

    def command(self, action: Float[np.ndarray, " m"], last: Float[np.ndarray, " n+1"]) -> Float[np.ndarray, " n+1"]:
        """The command for an action, given the last command."""
        ...

    def toward(self, wanted: Float[np.ndarray, " n+1"], last: Float[np.ndarray, " n+1"]) -> Float[np.ndarray, " m"]:
        """The action for a command, given the last one; outside of the action space if the command is too far away.

        The arm's part, divided by `effort`, is in the action space.
        """
        ...

    def effort(self, wanted: Float[np.ndarray, " n+1"], last: Float[np.ndarray, " n+1"]) -> float:
        """Environment steps that the arm needs from the last command to the wanted one, possibly less than 1."""
        ...


class JointPositionControl:
    """Actions are absolute joint positions (radians) and the finger coordinate θ."""

    def __init__(self, limits: CommandLimits) -> None:
        self.limits = limits
        self.action_space = spaces.Box(_up(limits.lower), _down(limits.upper), dtype=np.float32)

    def command(self, action: Float[np.ndarray, " n+1"], last: Float[np.ndarray, " n+1"]) -> np.ndarray:
        """The action, clipped to the action space and to one step."""
        wanted = np.clip(np.asarray(action, float), self.action_space.low, self.action_space.high)
        return self.limits.advance(last, wanted)

    def toward(self, wanted: Float[np.ndarray, " n+1"], last: Float[np.ndarray, " n+1"]) -> np.ndarray:
        """The command itself."""
        del last
        return np.asarray(wanted, float)

    def effort(self, wanted: Float[np.ndarray, " n+1"], last: Float[np.ndarray, " n+1"]) -> float:
        """Steps of the slowest joint."""
        return float((np.abs(wanted - last)[:-1] / self.limits.step).max())


class EndEffectorDeltaControl:
    """Actions translate and rotate the commanded gripper pose: (7,) in [−1, 1].

    Entries 0–2 translate along the world's axes (times ``translation_step``). Entries 3–5 are a rotation vector about
    the world's axes (times ``rotation_step``). Entry 6 sets the fingers, linearly from −1 (closed) to 1 (open). The
    commanded pose is that of the commanded joint positions, so it always stays reachable.

    The joint positions follow by damped least squares, Δq = Jᵀ(JJᵀ + λ²I)⁻¹e (Nakamura and Hanafusa, "Inverse
    kinematic solutions with singularity robustness", ASME J. Dyn. Sys. 1986), clipped to the limits at each iteration.
    """

    ITERATIONS = 12
    DAMPING = 0.02
    TOLERANCE = 1e-5

    def __init__(
        self,
        limits: CommandLimits,
        robot: mujoco.MjModel,
        joints: tuple[str, ...],
        site: str,
        translation_step: float,
        rotation_step: float,
    ) -> None:
        self.limits = limits
        self.action_space = spaces.Box(-1.0, 1.0, (7,), np.float32)
        self._scale = np.repeat([translation_step, rotation_step], 3)
        self._model = robot
        self._data = mujoco.MjData(robot)
        self._qpos = np.array([robot.joint(name).qposadr[0] for name in joints])
        self._dofs = np.array([robot.joint(name).dofadr[0] for name in joints])
        self._site = robot.site(site).id

    def command(self, action: Float[np.ndarray, " 7"], last: Float[np.ndarray, " n+1"]) -> np.ndarray:
        """Joint positions that move the gripper as the action asks, as near as limits allow."""
        action = np.clip(np.asarray(action, float), -1.0, 1.0)
        low, high = self.limits.lower[-1], self.limits.upper[-1]
        theta = low + 0.5 * (action[6] + 1) * (high - low)
        joints = last[:-1]
        # Without motion in the action, do not drift.
        if action[:6].any():
            position, rotation = self.gripper_frame(joints)
            delta = action[:6] * self._scale
            joints = self._solve(joints, position + delta[:3], _rotation(delta[3:]) @ rotation)
        return self.limits.advance(last, np.append(joints, theta))

    def toward(self, wanted: Float[np.ndarray, " n+1"], last: Float[np.ndarray, " n+1"]) -> np.ndarray:
        """The motion from the last commanded gripper pose to that of the wanted joint positions."""
        position, rotation = self.gripper_frame(last[:-1])
        new_position, new_rotation = self.gripper_frame(wanted[:-1])
        delta = np.concatenate([new_position - position, _rotation_vector(new_rotation @ rotation.T)]) / self._scale
        low, high = self.limits.lower[-1], self.limits.upper[-1]
        return np.append(delta, 2 * (wanted[-1] - low) / (high - low) - 1)

    def effort(self, wanted: Float[np.ndarray, " n+1"], last: Float[np.ndarray, " n+1"]) -> float:
        """Steps of the largest entry of the motion."""
        return float(np.abs(self.toward(wanted, last)[:6]).max())

    def gripper_frame(self, joints: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) and rotation (3, 3) of the gripper at these joint positions, world."""
        self._data.qpos[self._qpos] = joints
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        return self._data.site_xpos[self._site].copy(), self._data.site_xmat[self._site].reshape(3, 3).copy()

    def _solve(self, joints: np.ndarray, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        jacobian = np.zeros((6, self._model.nv))
        low, high = self.limits.lower[:-1], self.limits.upper[:-1]
        for _ in range(self.ITERATIONS):
            at, frame = self.gripper_frame(joints)
            error = np.concatenate([position - at, _rotation_vector(rotation @ frame.T)])
            if np.abs(error).max() < self.TOLERANCE:
                break
            mujoco.mj_jacSite(self._model, self._data, jacobian[:3], jacobian[3:], self._site)
            j = jacobian[:, self._dofs]
            step = j.T @ np.linalg.solve(j @ j.T + self.DAMPING**2 * np.eye(6), error)
            joints = np.clip(joints + step, low, high)
        return joints


def check_action(action: object, space: spaces.Box) -> Float[np.ndarray, " m"]:
    """The action as (m,) float64.

    Raises:
        ActionError: not an array of numbers, wrong shape, or not finite. Out-of-range entries are not an error: they
            are clipped.
    """
    try:
        array = np.asarray(action, float)
    except (TypeError, ValueError) as error:
        raise ActionError(f"action {action!r} is not an array of numbers; the action space is {space}") from error
    if array.shape != space.shape:
        raise ActionError(f"action has shape {array.shape}; the action space needs {space.shape}")
    bad = np.flatnonzero(~np.isfinite(array))
    if len(bad):
        raise ActionError(f"action[{bad[0]}] is {array[bad[0]]}; actions must be finite")
    return array


def _up(values: np.ndarray) -> np.ndarray:
    """Rounded up to float32: bounds of the action space must stay within the joint limits."""
    rounded = values.astype(np.float32)
    return np.where(rounded < values, np.nextafter(rounded, np.float32(np.inf)), rounded)


def _down(values: np.ndarray) -> np.ndarray:
    return -_up(-values)


def _rotation(vector: np.ndarray) -> Float[np.ndarray, "3 3"]:
    quaternion, matrix = np.zeros(4), np.zeros(9)
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle > 0 else np.array([1.0, 0, 0])
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _rotation_vector(rotation: np.ndarray) -> Float[np.ndarray, " 3"]:
    quaternion, vector = np.zeros(4), np.zeros(3)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    mujoco.mju_quat2Vel(vector, quaternion, 1.0)
    return vector
