"""Peers of IkSolve: mink, and a search from so many starts that it misses hardly any solution."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from regrasp_bench.peers.coal_checker import ExactChecker
from regrasp_bench.peers.optional import import_peer
from regrasp_gym.simulation.scenario import Scenario

POSITION, ROTATION = 1e-3, 1e-2
"""Errors (metres, radians) up to which the gripper counts as at its target."""
_EXACT = 1e-6
_ITERATIONS = 60
_LENGTH = 0.3
"""Length that weighs as much as a radian in the search, metres."""


def pose_errors(
    gripper: Float[np.ndarray, "*N 4 4"], target: Float[np.ndarray, "4 4"]
) -> tuple[Float[np.ndarray, "*N 3"], Float[np.ndarray, "*N 3"]]:
    """Errors from a gripper to its target: translations (metres) and rotation vectors (radians), in world axes."""
    turn = target[:3, :3] @ np.swapaxes(gripper[..., :3, :3], -1, -2)
    vectors = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec().reshape(turn.shape[:-1])
    return target[:3, 3] - gripper[..., :3, 3], vectors


def is_at_target(checker: ExactChecker, q: Float[np.ndarray, " n"], target: Float[np.ndarray, "4 4"]) -> bool:
    """Whether the gripper is at the target in configuration q, up to `POSITION` and `ROTATION`."""
    missing, turn = pose_errors(checker.frames(q[None])[0, -2], target)
    return bool(np.linalg.norm(missing) <= POSITION and np.linalg.norm(turn) <= ROTATION)


def exhaustive_search(
    checker: ExactChecker,
    target: Float[np.ndarray, "4 4"],
    rng: np.random.Generator,
    starts: int = 4096,
) -> Float[np.ndarray, " n"] | None:
    """A configuration at the target that keeps all margins, from random starts, or None.

    Damped least squares from each start, with joints clipped to their limits. It shares nothing with IkSolve.

    Args:
        checker: kinematics, joint limits and collisions.
        target: (4, 4) pose of the gripper in the world.
        rng: generator of the starts.
        starts: largest number of starts.
    """
    batch = 256
    for _ in range(0, starts, batch):
        q = rng.uniform(checker.lower, checker.upper, (batch, len(checker.lower)))
        for _ in range(_ITERATIONS):
            step, _ = _step(checker, q, target)
            q = np.clip(q + step, checker.lower, checker.upper)
        reached = q[_step(checker, q, target)[1] < _EXACT]
        if len(reached):
            kept = reached[checker.keeps_margins(reached)]
            if len(kept):
                return kept[0]
    return None


def _step(
    checker: ExactChecker, q: Float[np.ndarray, "N n"], target: Float[np.ndarray, "4 4"]
) -> tuple[Float[np.ndarray, "N n"], Float[np.ndarray, " N"]]:
    """Damped Gauss–Newton steps, and the errors before them: metres or radians, whichever is larger."""
    frames = checker.frames(q)
    missing, turn = pose_errors(frames[:, -2], target)
    joints = frames[:, 1:-2]
    axes = (joints[..., :3, :3] @ checker.axes[..., None])[..., 0]
    levers = frames[:, None, -2, :3, 3] - joints[..., :3, 3]
    jacobian = np.concatenate([np.cross(axes, levers), _LENGTH * axes], axis=-1).swapaxes(1, 2)
    error = np.concatenate([missing, _LENGTH * turn], axis=-1)
    squared = jacobian @ jacobian.swapaxes(1, 2) + 1e-6 * np.eye(6)
    step = (jacobian.swapaxes(1, 2) @ np.linalg.solve(squared, error[..., None]))[..., 0]
    longest = np.abs(step).max(axis=1, keepdims=True)
    size = np.maximum(np.linalg.norm(missing, axis=1), np.linalg.norm(turn, axis=1))
    return step * np.minimum(1.0, 0.5 / np.maximum(longest, 1e-12)), size


@dataclass(frozen=True)
class MinkResult:
    """Outcome of mink.

    Attributes:
        q: (n,) a configuration at the target that is free of collisions, radians; None if none was found.
        seconds: time of everything, collision checks included.
        starts: number of starts used.
        reached: number of starts that led to the target, in collision or not.
        first_reached: whether the first start did.
    """

    q: Float[np.ndarray, " n"] | None
    seconds: float
    starts: int
    reached: int
    first_reached: bool


class MinkPeer:
    """Mink's differential inverse kinematics on the robot alone, one quadratic program per step.

    Args:
        scenario: scenario of the robot.

    Raises:
        BenchError: mink is not installed.
    """

    def __init__(self, scenario: Scenario):
        self._mink: Any = import_peer("mink")
        model = scenario.robot.build_spec().compile()
        self._configuration = self._mink.Configuration(model)
        self._task = self._mink.FrameTask(
            scenario.robot.tcp_site, "site", position_cost=1.0, orientation_cost=_LENGTH, lm_damping=1e-2
        )
        self._limits = [self._mink.ConfigurationLimit(model, gain=0.95)]
        self._joints = np.array([model.joint(name).qposadr[0] for name in scenario.robot.arm_joints])

    def solve(
        self, checker: ExactChecker, target: Float[np.ndarray, "4 4"], starts: Float[np.ndarray, "S n"]
    ) -> MinkResult:
        """Descend from each start in turn, until a configuration at the target is free of collisions.

        Args:
            checker: tells which configurations are free.
            target: (4, 4) pose of the gripper in the world.
            starts: (S, n) configurations, radians.
        """
        began = time.perf_counter()
        self._task.set_target(self._mink.SE3.from_matrix(target))
        reached, first_reached = 0, False
        for k, start in enumerate(starts):
            q = self._descend(start)
            if q is None:
                continue
            reached += 1
            first_reached |= k == 0
            if checker.free(q[None]):
                return MinkResult(q, time.perf_counter() - began, k + 1, reached, first_reached)
        return MinkResult(None, time.perf_counter() - began, len(starts), reached, first_reached)

    def _descend(self, start: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"] | None:
        configuration, task = self._configuration, self._task
        q = np.array(configuration.q)
        q[self._joints] = start
        configuration.update(q)
        for _ in range(_ITERATIONS):
            velocity = self._mink.solve_ik(configuration, [task], 1.0, "daqp", limits=self._limits)
            configuration.integrate_inplace(velocity, 1.0)
            error = task.compute_error(configuration)
            if np.linalg.norm(error[:3]) < 0.1 * POSITION and np.linalg.norm(error[3:]) < 0.1 * ROTATION:
                return np.array(configuration.q)[self._joints]
        return None
