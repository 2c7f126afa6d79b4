"""Inverse kinematics of the arm alone: damped least squares from many starts at once, within the joint limits."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from regrasp_planner.robot.kinematics import forward_kinematics, gripper_jacobian, pose_error
from regrasp_planner.robot.model import Arm

CONVERGED_POSITION = 1e-6
CONVERGED_ROTATION = 1e-6
POLISH = 2
"""Iterations after the last that was needed: they bring lanes that were nearly there to full precision."""
ROTATION_LENGTH = 0.25
"""Metres that count as much as a radian in the pose error: about the distance of the wrist's axes from the tool."""


class Reached(NamedTuple):
    """Configurations found by `reach`, for L lanes.

    Attributes:
        q: (L, n) radians, within the limits.
        position_error: (L,) metres.
        rotation_error: (L,) radians.
    """

    q: Float[Array, "L n"]
    position_error: Float[Array, " L"]
    rotation_error: Float[Array, " L"]


def solve_positive(matrix: Float[Array, "m m"], right: Float[Array, " m"]) -> Float[Array, " m"]:
    """Solution of a small symmetric positive definite system.

    Cholesky's factorisation written out in scalars: over a batch each step is one vector operation, where a LAPACK
    call per matrix would cost more than all else in the solver.
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
    error: Float[Array, "L 6"]
    done: Bool[Array, " L"]
    iterations: Int[Array, ""]
    polish: Int[Array, ""]


@jax.jit
def reach(
    arm: Arm,
    targets: Float[Array, "K 7"],
    starts: Float[Array, "K S n"],
    enough: Int[Array, ""],
    max_iterations: Int[Array, ""],
) -> Reached:
    """Configurations whose gripper frame is at the targets, from S starts for each of K targets.

    Damped least squares with the damping of Sugihara ("Solvability-unconcerned inverse kinematics by the
    Levenberg–Marquardt method", IEEE T-RO 2011): proportional to the squared error, so that it is robust far away and
    quadratic near a solution. Joints at a limit that the step would push outwards are held.

    Args:
        arm: the chain with its limits.
        targets: (K, 7) wanted poses of the gripper frame in the world.
        starts: (K, S, n) radians; brought within the limits first.
        enough: stop once every target has this many solutions.
        max_iterations: cap.

    Returns:
        `Reached` for L = K·S lanes, target by target. Lanes still on their way have larger errors.
    """
    n_targets, n_starts, dof = starts.shape
    goals = jnp.repeat(targets, n_starts, axis=0)
    scale = jnp.array([1.0] * 3 + [ROTATION_LENGTH] * 3)

    def look(q: Float[Array, " n"], goal: Float[Array, " 7"]) -> tuple[Float[Array, " 6"], Float[Array, "6 n"]]:
        frames = forward_kinematics(arm, q)
        return pose_error(frames[-1], goal), gripper_jacobian(arm, frames)

    def step(q: Float[Array, " n"], goal: Float[Array, " 7"]) -> tuple[Float[Array, " n"], Float[Array, " 6"]]:
        error, jacobian = look(q, goal)
        e, j = scale * error, scale[:, None] * jacobian
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
        moved = jnp.where(done[:, None], state.q, moved)
        return _State(moved, error, done, state.iterations + 1, state.polish - settled)

    def unfinished(state: _State) -> Bool[Array, ""]:
        return (state.iterations < max_iterations) & (state.polish > 0)

    q = jnp.clip(starts.reshape(-1, dof), arm.lower, arm.upper)
    lanes = q.shape[0]
    begin = _State(q, jnp.full((lanes, 6), jnp.inf), jnp.zeros(lanes, bool), jnp.asarray(0), jnp.asarray(POLISH))
    end = jax.lax.while_loop(unfinished, body, begin)
    error = jax.vmap(lambda q, goal: pose_error(forward_kinematics(arm, q)[-1], goal))(end.q, goals)
    return Reached(end.q, jnp.linalg.norm(error[:, :3], axis=1), jnp.linalg.norm(error[:, 3:], axis=1))
