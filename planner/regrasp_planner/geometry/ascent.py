"""Maximising smoothed functions on the sphere from many starts at once: trust-region Newton with rising sharpness.

The tangent plane has two dimensions, so the second-order model is solved exactly. The sharpness p is raised stage by
stage for each start on its own; as a maximiser moves like 1/p, the step into a new stage is extrapolated. A step that
overshoots a crease is cut where the tangents at both ends meet. Arrays keep the starts in their last axis, so that
every operation is elementwise over them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from regrasp_planner.geometry.support import whole_power

STAGE_FACTOR = 8.0
STAGE_TOLERANCE = 0.1
"""A stage has settled when the predicted gain is below this share of size / p, what the next stage changes F by."""

FIRST_RADIUS = 0.25
MAX_EVALUATIONS = 60
STEP_TOLERANCE = 1e-5
"""Last Newton step as a share of 1/p radians, the width of a crease; what remains after it is of its square."""


def core_terms(
    offsets: Float[Array, "3 V N"], x: Float[Array, "3 N"], p: Float[Array, " N"] | int
) -> tuple[Float[Array, " N"], Float[Array, "3 N"], Float[Array, "6 N"]]:
    """Value, gradient (3, N) and Hessian (xx, yy, zz, xy, xz, yz) of k(x) = m S^{1/p} for whole numbers p.

    A p known beforehand, as an ``int``, is quicker, most of all with p − 2 a power of two.
    """
    heights = jnp.maximum(offsets[0] * x[0] + offsets[1] * x[1] + offsets[2] * x[2], 0.0)
    top = heights.max(0)
    ratio = heights / top
    # Without the barrier the compiler would compute the powers anew for each of the ten sums.
    power = jax.lax.integer_pow(ratio, p - 2) if isinstance(p, int) else whole_power(ratio, p - 2)
    weight = jax.lax.optimization_barrier(power)
    u = [weight * offsets[i] for i in range(3)]
    terms = (
        weight * ratio * ratio,
        *(ratio * u[i] for i in range(3)),
        *(u[i] * offsets[j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))),
    )
    zero = jnp.zeros((), x.dtype)
    sums = jax.lax.reduce(terms, (zero,) * 10, lambda a, b: tuple(i + j for i, j in zip(a, b, strict=True)), (0,))
    total = sums[0]
    root = jnp.exp(jnp.log(total) / p)
    scale = root / total
    gradient = jnp.stack([scale * part for part in sums[1:4]])
    value = top * root
    curvature = jnp.stack(sums[4:]) * (scale / top)
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    outer = jnp.stack([gradient[i] * gradient[j] for i, j in pairs]) / value
    return value, gradient, (p - 1) * (curvature - outer)


def tangent_basis(x: Float[Array, "3 N"]) -> tuple[Float[Array, "3 N"], Float[Array, "3 N"]]:
    """Two unit vectors orthogonal to the unit vectors x and to each other (Duff et al., JCGT 2017)."""
    sign = jnp.where(x[2] >= 0, 1.0, -1.0)
    a = -1.0 / (sign + x[2])
    b = x[0] * x[1] * a
    u = jnp.stack([1.0 + sign * x[0] * x[0] * a, sign * b, -sign * x[0]])
    v = jnp.stack([b, sign + x[1] * x[1] * a, -x[1]])
    return u, v


def quadratic(h: Float[Array, "6 N"], u: Float[Array, "3 N"], v: Float[Array, "3 N"]) -> Float[Array, " N"]:
    """uᵀ H v for symmetric H given as (xx, yy, zz, xy, xz, yz)."""
    return (
        h[0] * u[0] * v[0]
        + h[1] * u[1] * v[1]
        + h[2] * u[2] * v[2]
        + h[3] * (u[0] * v[1] + u[1] * v[0])
        + h[4] * (u[0] * v[2] + u[2] * v[0])
        + h[5] * (u[1] * v[2] + u[2] * v[1])
    )


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Model:
    """Value of F at x, and gradient and (negated) Hessian of its second-order model in `tangent_basis`."""

    value: Float[Array, " N"]
    gu: Float[Array, " N"]
    gv: Float[Array, " N"]
    huu: Float[Array, " N"]
    huv: Float[Array, " N"]
    hvv: Float[Array, " N"]


def newton_step(
    model: Model, radius: Float[Array, " N"]
) -> tuple[Float[Array, " N"], Float[Array, " N"], Float[Array, " N"], Float[Array, " N"]]:
    """Ascent step (in u, v), its predicted gain, and the length of the full step.

    The 2×2 Hessian is diagonalised and its eigenvalues are replaced by their absolute values, so that the step climbs
    out of saddles and minima too.
    """
    mean = 0.5 * (model.huu + model.hvv)
    half = 0.5 * (model.huu - model.hvv)
    root = jnp.sqrt(half * half + model.huv * model.huv)
    high, low = mean + root, mean - root
    # Eigenvector of ``high``, from the better conditioned of the two rows.
    ex = jnp.where(half >= 0, half + root, model.huv)
    ey = jnp.where(half >= 0, model.huv, root - half)
    norm = jnp.sqrt(ex * ex + ey * ey)
    ex, ey = jnp.where(norm > 0, ex / norm, 1.0), jnp.where(norm > 0, ey / norm, 0.0)
    floor = 1e-9 * (jnp.abs(high) + jnp.abs(low)) + jnp.finfo(mean.dtype).tiny
    high, low = jnp.maximum(jnp.abs(high), floor), jnp.maximum(jnp.abs(low), floor)
    g_high, g_low = ex * model.gu + ey * model.gv, ex * model.gv - ey * model.gu
    s_high, s_low = g_high / high, g_low / low
    length = jnp.sqrt(s_high * s_high + s_low * s_low)
    shrink = jnp.minimum(1.0, radius / jnp.maximum(length, jnp.finfo(mean.dtype).tiny))
    gain = (g_high * s_high + g_low * s_low) * (shrink - 0.5 * shrink * shrink)
    return shrink * (ex * s_high - ey * s_low), shrink * (ey * s_high + ex * s_low), gain, length


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Ascent:
    """State of the climbs.

    Attributes:
        x: (3, N) unit directions.
        settled: (3, N) where the last stage settled, for extrapolation.
        model: model at x.
        stage: (N,) sharpness now.
        radius: (N,) trust radius, radians.
        done: (N,) converged.
        count: evaluations of F so far.
    """

    x: Float[Array, "3 N"]
    settled: Float[Array, "3 N"]
    model: Model
    stage: Float[Array, " N"]
    radius: Float[Array, " N"]
    done: Bool[Array, " N"]
    count: Int[Array, ""]


def climb(
    model_at: Callable[[Float[Array, "3 N"], Float[Array, " N"]], Model],
    size: Float[Array, " N"],
    last: Float[Array, " N"],
    start: Float[Array, "3 N"],
    stage: Float[Array, " N"],
    active: Bool[Array, " N"],
    patience: int | Int[Array, ""] = 0,
    widest: float = np.pi,
    tolerance: float = STEP_TOLERANCE,
    evaluations: int = MAX_EVALUATIONS,
) -> Ascent:
    """Climb a smoothed function on the sphere from unit ``start`` directions, raising its sharpness stage by stage.

    Args:
        model_at: second-order model at unit directions (3, N) and sharpnesses (N,).
        size: (N,) length scale of the bodies, metres.
        last: (N,) final sharpness.
        start: (3, N) unit directions.
        stage: (N,) sharpness to begin with.
        active: (N,) the others keep their start and count as done.
        patience: stop when at most this many are unfinished.
        widest: longest step, radians.
        tolerance: length of the last step times p, radians.
        evaluations: most evaluations of each.
    """
    first = jnp.minimum(stage, last)
    noise = 1e-15 * size
    tiny = jnp.finfo(size.dtype).tiny
    first_radius = min(FIRST_RADIUS, widest)

    def advance(state: Ascent) -> Ascent:
        step_u, step_v, gain, length = newton_step(state.model, state.radius)
        taken = jnp.minimum(length, state.radius)
        final = state.stage >= last
        settled = jnp.where(final, length * state.stage < tolerance, gain * state.stage < STAGE_TOLERANCE * size)
        raised = settled & ~final
        stage = jnp.where(raised, jnp.minimum(STAGE_FACTOR * state.stage, last), state.stage)

        u, v = tangent_basis(state.x)
        step = step_u * u + step_v * v
        here = state.x + step
        before = state.stage / STAGE_FACTOR
        lead = (1 / state.stage - 1 / stage) / (1 / before - 1 / state.stage)
        trial = here + jnp.where(raised & (state.stage > first), lead, 0.0) * (here - state.settled)
        trial = trial / jnp.sqrt((trial * trial).sum(0))

        model = model_at(trial, stage)
        ratio = (model.value - state.model.value + noise) / (gain + noise)
        moves = (settled | (ratio > 0.02)) & ~state.done
        # The tangents at both ends of the step meet at ``cut``: there lies the crease that spoiled the model.
        trial_u, trial_v = tangent_basis(trial)
        rise = (state.model.gu * step_u + state.model.gv * step_v) / (taken + tiny)
        fall = (model.gu * (trial_u * step).sum(0) + model.gv * (trial_v * step).sum(0)) / (taken + tiny)
        cut = (model.value - state.model.value - fall * taken) / (rise - fall + tiny)
        cut = jnp.clip(cut, 0.02 * taken, 0.6 * taken)
        narrowed = jnp.where(moves, jnp.maximum(taken - cut, 0.02 * taken), cut)
        radius = jnp.where(ratio < 0.2, narrowed, state.radius)
        radius = jnp.where((ratio > 0.7) & (length > state.radius), jnp.minimum(2.0 * radius, widest), radius)
        return Ascent(
            jnp.where(moves, trial, state.x),
            jnp.where(settled, here, state.settled),
            jax.tree.map(lambda new, old: jnp.where(moves, new, old), model, state.model),
            stage,
            jnp.where(settled, first_radius, radius),
            state.done | (settled & final),
            state.count + 1,
        )

    zero, one = jnp.zeros_like(start[0]), jnp.ones_like(start[0])
    # With a flat model the first pass settles at once and "raises" the sharpness to that of the first stage.
    begin = Ascent(
        start,
        start,
        Model(zero, zero, zero, one, zero, one),
        first / STAGE_FACTOR,
        first_radius * one,
        ~active,
        jnp.zeros((), jnp.int32),
    )

    def unfinished(state: Ascent) -> Bool[Array, ""]:
        return (state.count < evaluations) & ((~state.done).sum() > patience)

    return jax.lax.while_loop(unfinished, advance, begin)
