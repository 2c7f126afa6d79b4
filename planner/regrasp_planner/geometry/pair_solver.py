"""Maximisers on S² of the signed-distance function of many body pairs at once.

For bodies A and B the signed distance is the maximum over unit x of

    F(x) = x·(c_B − c_A) − k_A(x) − k_B(−x) − (r_A + r_B)‖x‖,

with c the centres, r the sweeps and k = m S^{1/p} the core of the DSF (see `support`) about the centre. F is of degree
1, so its Riemannian gradient on the sphere is P∇F and its Riemannian Hessian P∇²F P − F·I. It is concave for separated
bodies (F > 0), where the maximiser is unique.

All pairs advance together in one loop: a trust-region Newton method with the exact 2×2 tangent model, whose sharpness
is raised stage by stage for each pair on its own. Arrays keep the pairs in their last axis, and vertices are turned
into world axes once, so that every operation is elementwise over pairs.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from regrasp_planner.geometry.support import whole_power

FIRST_SHARPNESS = 16.0
STAGE_FACTOR = 4.0
STAGE_TOLERANCE = 0.02
MAX_EVALUATIONS = 48


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Pairs:
    """N pairs in world axes.

    Attributes:
        offsets_a: (3, V, N) vertices of A about its centre, metres.
        offsets_b: (3, W, N) minus the vertices of B about its centre, metres.
        shift: (3, N) centre of B minus centre of A, metres.
        sweep: (N,) sum of both radii, metres.
        sharpness_a, sharpness_b: (N,) whole numbers p.
    """

    offsets_a: Float[Array, "3 V N"]
    offsets_b: Float[Array, "3 W N"]
    shift: Float[Array, "3 N"]
    sweep: Float[Array, " N"]
    sharpness_a: Float[Array, " N"]
    sharpness_b: Float[Array, " N"]


def core_terms(
    offsets: Float[Array, "3 V N"], x: Float[Array, "3 N"], p: Float[Array, " N"]
) -> tuple[Float[Array, " N"], Float[Array, "3 N"], Float[Array, "6 N"]]:
    """Value, gradient (3, N) and Hessian (xx, yy, zz, xy, xz, yz) of k(x) = m S^{1/p} for whole numbers p."""
    heights = jnp.maximum(offsets[0] * x[0] + offsets[1] * x[1] + offsets[2] * x[2], 0.0)
    top = heights.max(0)
    ratio = heights / top
    # Without the barrier the compiler would compute the powers anew for each of the ten sums.
    weight = jax.lax.optimization_barrier(whole_power(ratio, jnp.broadcast_to(p - 2, ratio.shape)))
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


def tangent_model(pairs: Pairs, x: Float[Array, "3 N"], stage: Float[Array, " N"]) -> Model:
    """Second-order model of F at the unit vectors x with both sharpnesses capped at ``stage``."""
    value_a, gradient_a, hessian_a = core_terms(pairs.offsets_a, x, jnp.minimum(stage, pairs.sharpness_a))
    value_b, gradient_b, hessian_b = core_terms(pairs.offsets_b, x, jnp.minimum(stage, pairs.sharpness_b))
    gradient = pairs.shift - gradient_a - gradient_b
    value = (pairs.shift * x).sum(0) - value_a - value_b - pairs.sweep
    hessian = hessian_a + hessian_b
    u, v = tangent_basis(x)
    bend = value + pairs.sweep
    return Model(
        value,
        (gradient * u).sum(0),
        (gradient * v).sum(0),
        quadratic(hessian, u, u) + bend,
        quadratic(hessian, u, v),
        quadratic(hessian, v, v) + bend,
    )


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
class _State:
    x: Float[Array, "3 N"]
    model: Model
    stage: Float[Array, " N"]
    radius: Float[Array, " N"]
    done: Bool[Array, " N"]
    count: Int[Array, ""]


def climb(
    pairs: Pairs,
    start: Float[Array, "3 N"],
    active: Bool[Array, " N"],
    first: Float[Array, " N"] | float = FIRST_SHARPNESS,
    tolerance: float = 1e-7,
) -> tuple[Float[Array, "3 N"], Int[Array, ""]]:
    """Local maximisers of F reached from unit ``start`` directions, (3, N), and the number of evaluations.

    Args:
        pairs: the problems.
        start: (3, N) unit directions.
        active: (N,) the others keep their start.
        first: sharpness of the first stage.
        tolerance: length, radians, of the last Newton step; what remains is of its square.
    """
    last = jnp.maximum(pairs.sharpness_a, pairs.sharpness_b)
    size = jnp.sqrt((pairs.offsets_a**2).sum(0).max(0)) + jnp.sqrt((pairs.offsets_b**2).sum(0).max(0))
    zero, one = jnp.zeros_like(size), jnp.ones_like(size)

    def advance(state: _State) -> _State:
        step_u, step_v, gain, length = newton_step(state.model, state.radius)
        final = state.stage >= last
        settled = jnp.where(final, length < tolerance, gain * state.stage < STAGE_TOLERANCE * size)
        stage = jnp.where(settled & ~final, jnp.minimum(STAGE_FACTOR * state.stage, last), state.stage)
        u, v = tangent_basis(state.x)
        trial = state.x + step_u * u + step_v * v
        trial = trial / jnp.sqrt((trial * trial).sum(0))
        model = tangent_model(pairs, trial, stage)
        ratio = (model.value - state.model.value + 1e-15 * size) / (gain + 1e-15 * size)
        good = ratio > 0.02
        moves = (settled | good) & ~state.done
        radius = jnp.where(ratio < 0.2, 0.25 * jnp.minimum(length, state.radius), state.radius)
        radius = jnp.where((ratio > 0.7) & (length > state.radius), 2.0 * state.radius, radius)
        return _State(
            jnp.where(moves, trial, state.x),
            jax.tree.map(lambda new, old: jnp.where(moves, new, old), model, state.model),
            stage,
            jnp.where(settled, 0.5, radius),
            state.done | (settled & final),
            state.count + 1,
        )

    still = Model(zero, zero, zero, one, zero, one)
    begin = _State(
        start,
        still,
        jnp.minimum(jnp.broadcast_to(jnp.asarray(first), size.shape), last) / STAGE_FACTOR,
        0.5 * one,
        ~active,
        jnp.zeros((), jnp.int32),
    )
    end = jax.lax.while_loop(lambda s: (s.count < MAX_EVALUATIONS) & ~s.done.all(), advance, begin)
    return end.x, end.count


def maximisers(pairs: Pairs, start: Float[Array, "3 N"]) -> Float[Array, "3 N"]:
    """Global maximisers of F, (3, N) unit, climbed from ``start`` and, for overlapping pairs, from more directions."""
    length = jnp.sqrt((start * start).sum(0))
    unit = jnp.where(length > 0, start / jnp.where(length > 0, length, 1.0), jnp.asarray([[0.0], [0.0], [1.0]]))
    x, _ = climb(pairs, unit, jnp.ones(unit.shape[1], bool))
    return x
