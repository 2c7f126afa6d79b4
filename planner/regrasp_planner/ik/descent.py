"""Inverse kinematics of the arm alone: damped least squares from many starts at once, within the joint limits."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from regrasp_planner.robot.kinematics import forward_kinematics, gripper_jacobian, pose_error
from regrasp_planner.robot.model import Arm

POSITION_TOLERANCE = 1e-4
ROTATION_TOLERANCE = 1e-3
"""Largest errors of a solution, metres and radians."""
CONVERGED_POSITION = 1e-6
CONVERGED_ROTATION = 1e-6
"""Errors below which a lane stops."""
POLISH = 2
"""Extra iterations once there are enough solutions. They bring lanes that have nearly converged to full precision."""
ROTATION_LENGTH = 0.25
"""Metres per radian in the pose error: about the distance of the wrist's axes from the tool."""


class Descent(NamedTuple):
    """Where descents ended, one per lane: K targets × S starts, or any other batch.

    Attributes:
        q: (*lanes, n) radians, within the limits.
        position_error: (*lanes,) metres.
        rotation_error: (*lanes,) radians.
    """

    q: Float[np.ndarray, "*lanes n"]
    position_error: Float[np.ndarray, "*lanes"]
    rotation_error: Float[np.ndarray, "*lanes"]

    def pose_error(self) -> Float[np.ndarray, "*lanes"]:
        """Position and rotation error as one length in metres; a radian counts as `ROTATION_LENGTH`."""
        return self.position_error + ROTATION_LENGTH * self.rotation_error

    def solved(self) -> Bool[np.ndarray, "*lanes"]:
        """Whether both errors are within the tolerances."""
        return (self.position_error < POSITION_TOLERANCE) & (self.rotation_error < ROTATION_TOLERANCE)


def descend_to_pose(
    arm: Arm, targets: Float[np.ndarray, "K 7"], starts: Float[np.ndarray, "K S n"], enough: int, max_iterations: int
) -> Descent:
    """Descend from S starts for each of K targets until the gripper frame is at the target.

    Damped least squares with the damping of Sugihara ("Solvability-unconcerned inverse kinematics by the
    Levenberg–Marquardt method", IEEE T-RO 2011). The damping is proportional to the squared error: robust far away,
    quadratic near a solution. A joint at its limit is held if the step would push it outwards.

    Args:
        arm: the chain with its limits.
        targets: (K, 7) poses of the gripper frame in the world.
        starts: (K, S, n) radians; clipped to the limits first.
        enough: stop once every target has this many solutions.
        max_iterations: largest number of iterations.

    Returns:
        K × S lanes. Lanes that have not converged have larger errors.
    """
    ends = _descend(arm, jnp.asarray(targets), jnp.asarray(starts), jnp.asarray(enough), jnp.asarray(max_iterations))
    return Descent(*(np.asarray(leaf).reshape(*starts.shape[:2], *leaf.shape[1:]) for leaf in ends))


def solve_positive(matrix: Float[Array, "m m"], right: Float[Array, " m"]) -> Float[Array, " m"]:
    """Solution of a small symmetric positive definite system.

    Cholesky's factorisation, written out in scalars. Over a batch each step is one vector operation; a LAPACK call per
    matrix would cost more than the rest of the solver.
    """
    size = right.shape[0]
    low: list[list[Array]] = [[] for _ in range(size)]
    for i in range(size):
        for j in range(i):
            low[i].append((matrix[i, j] - sum(low[i][k] * low[j][k] for k in range(j))) / low[j][j])
        low[i].append(jnp.sqrt(jnp.maximum(matrix[i, i] - sum(low[i][k] ** 2 for k in range(i)), 1e-30)))
    forward: list[Array] = []
    for i in range(size):
        forward.append((right[i] - sum(low[i][k] * forward[k] for k in range(i))) / low[i][i])
    back: list[Array] = [forward[0]] * size
    for i in reversed(range(size)):
        back[i] = (forward[i] - sum(low[k][i] * back[k] for k in range(i + 1, size))) / low[i][i]
    return jnp.stack(back)


class _State(NamedTuple):
    q: Float[Array, "L n"]
    iterations: Int[Array, ""]
    polish: Int[Array, ""]


@jax.jit
def _descend(
    arm: Arm, targets: Float[Array, "K 7"], starts: Float[Array, "K S n"], enough: Array, max_iterations: Array
) -> tuple[Float[Array, "L n"], Float[Array, " L"], Float[Array, " L"]]:
    """Configurations and errors of L = K·S lanes, target by target; see `descend_to_pose`."""
    n_targets, n_starts, dof = starts.shape
    goals = jnp.repeat(targets, n_starts, axis=0)
    scale = jnp.array([1.0] * 3 + [ROTATION_LENGTH] * 3)

    def step(q: Float[Array, " n"], goal: Float[Array, " 7"]) -> tuple[Float[Array, " n"], Float[Array, " 6"]]:
        frames = forward_kinematics(arm, q)
        error = pose_error(frames[-1], goal)
        e, j = scale * error, scale[:, None] * gripper_jacobian(arm, frames)
        slope = e @ j
        held = ((q <= arm.lower) & (slope < 0)) | ((q >= arm.upper) & (slope > 0))
        j = jnp.where(held, 0.0, j)
        damping = 0.1 * (e @ e) + 1e-9
        dq = solve_positive(j @ j.T + damping * jnp.eye(6), e) @ j
        longest = jnp.max(jnp.abs(dq))
        dq = dq * jnp.minimum(1.0, 1.0 / jnp.maximum(longest, 1e-12))
        return jnp.clip(q + dq, arm.lower, arm.upper), error

    def body(state: _State) -> _State:
        moved, error = jax.vmap(step)(state.q, goals)
        near = jnp.linalg.norm(error[:, :3], axis=1) < CONVERGED_POSITION
        done = near & (jnp.linalg.norm(error[:, 3:], axis=1) < CONVERGED_ROTATION)
        solved = done.reshape(n_targets, n_starts).sum(1)
        settled = jnp.all(solved >= jnp.minimum(enough, n_starts))
        return _State(jnp.where(done[:, None], state.q, moved), state.iterations + 1, state.polish - settled)

    def unfinished(state: _State) -> Bool[Array, ""]:
        return (state.iterations < max_iterations) & (state.polish > 0)

    begin = _State(jnp.clip(starts.reshape(-1, dof), arm.lower, arm.upper), jnp.asarray(0), jnp.asarray(POLISH))
    q = jax.lax.while_loop(unfinished, body, begin).q
    error = jax.vmap(lambda q, goal: pose_error(forward_kinematics(arm, q)[-1], goal))(q, goals)
    return q, jnp.linalg.norm(error[:, :3], axis=1), jnp.linalg.norm(error[:, 3:], axis=1)
