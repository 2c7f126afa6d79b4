"""Maximisers on S² of the signed-distance function of many body pairs at once.

For bodies A and B the signed distance is the maximum over unit x of

    F(x) = x·(c_B − c_A) − k_A(x) − k_B(−x) − (r_A + r_B)‖x‖,

with c the centres, r the sweeps and k = m S^{1/p} the core of the DSF (see `support`) about the centre. F is of degree
1, so its Riemannian gradient on the sphere is P∇F and its Riemannian Hessian P∇²F P − F·I. It is concave for separated
bodies (F > 0), where the maximiser is unique.

All pairs advance together in one loop: a trust-region Newton method with the exact 2×2 tangent model, whose sharpness
is raised stage by stage for each pair on its own. As the maximiser moves like 1/p, the step into a new stage is
extrapolated. A step that overshoots a crease of F is cut where the tangents at both ends meet. Arrays keep the pairs in
their last axis, and vertices are turned into world axes once, so that every operation is elementwise over pairs.

A batch goes at the pace of its slowest pair. So the loop over all pairs ends when few are left; these, and the further
starts of overlapping pairs, where F has several maxima, are worked off as a queue in rounds of fewer lanes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from regrasp_planner.geometry.support import whole_power

FIRST_SHARPNESS = 32.0
"""Sharpness of the first stage: low enough that creases are wide, high enough to save a stage at p = 32."""

STAGE_FACTOR = 8.0
STAGE_TOLERANCE = 0.1
"""A stage has settled when the predicted gain is below this share of size / p, what the next stage changes F by."""

FIRST_RADIUS = 0.25
MAX_EVALUATIONS = 60
STEP_TOLERANCE = 1e-5
"""Last Newton step as a share of 1/p radians, the width of a crease; what remains after it is of its square."""

BLOCK = 48
"""Most pairs to advance in lockstep: enough to fill the vector units, few enough that the slowest is not slow."""


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


def hull_value(pairs: Pairs, x: Float[Array, "3 ... N"]) -> Float[Array, "... N"]:
    """F of the exact swept hulls (p → ∞) at unit directions x (3, …, N), metres."""
    value = (x * _aligned(pairs.shift, x)).sum(0) - pairs.sweep
    for offsets in (pairs.offsets_a, pairs.offsets_b):
        corners = jnp.moveaxis(offsets, 1, 0)
        value = value - jax.lax.reduce(
            sum(_aligned(corners[:, i], x[0][None]) * x[i] for i in range(3)),
            jnp.zeros((), x.dtype),
            jax.lax.max,
            (0,),
        )
    return value


def _aligned(values: Float[Array, "k N"], x: Float[Array, ...]) -> Float[Array, "k ... N"]:
    """``values`` (k, N) with as many middle axes as x has."""
    return values.reshape(values.shape[0], *(1,) * (x.ndim - 2), values.shape[-1])


def first_guess(pairs: Pairs) -> Float[Array, "3 N"]:
    """The better of two directions: from centre to centre, and the normal there of the bodies' inertial ellipsoid.

    The second one sees how flat a slab or a rod is: M⁻¹ Δ with M the sum of both second moments of the vertices.
    """
    order = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    moments = []
    for offsets in (pairs.offsets_a, pairs.offsets_b):
        count = (jnp.abs(offsets).sum(0) > 0).sum(0)
        terms = tuple(offsets[i] * offsets[j] for i, j in order)
        zero = jnp.zeros((), offsets.dtype)
        sums = jax.lax.reduce(terms, (zero,) * 6, lambda a, b: tuple(i + j for i, j in zip(a, b, strict=True)), (0,))
        moments.append([part / count for part in sums])
    xx, yy, zz, xy, xz, yz = (a + b for a, b in zip(*moments, strict=True))
    ridge = 1e-4 * (xx + yy + zz)
    xx, yy, zz = xx + ridge, yy + ridge, zz + ridge
    d = pairs.shift
    cross_xy, cross_xz, cross_yz = xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - xx * yz
    normal = jnp.stack(
        [
            (yy * zz - yz * yz) * d[0] + cross_xy * d[1] + cross_xz * d[2],
            cross_xy * d[0] + (xx * zz - xz * xz) * d[1] + cross_yz * d[2],
            cross_xz * d[0] + cross_yz * d[1] + (xx * yy - xy * xy) * d[2],
        ]
    )
    line, normal = unit(d), unit(normal)
    better = hull_value(pairs, jnp.stack([line, normal], axis=1))
    return jnp.where(better[1] > better[0], normal, line)


def unit(vectors: Float[Array, "3 N"]) -> Float[Array, "3 N"]:
    """``vectors`` (3, …) scaled to unit length; zero becomes the z axis."""
    largest = jnp.abs(vectors).max(0)
    scaled = vectors / jnp.where(largest > 0, largest, 1.0)
    fallback = jnp.zeros_like(scaled).at[2].set(1.0)
    scaled = jnp.where(largest > 0, scaled, fallback)
    return scaled / jnp.sqrt((scaled * scaled).sum(0))


def _sectors() -> np.ndarray:
    """(3, 9, 6) unit directions: a 3×3 grid on each of the six faces of a cube."""
    grid = np.array([(a, b) for a in (-0.66, 0.0, 0.66) for b in (-0.66, 0.0, 0.66)])
    faces = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            face = np.insert(grid, axis, sign, axis=1)
            faces.append(face / np.linalg.norm(face, axis=1, keepdims=True))
    return np.stack(faces).transpose(2, 1, 0)


SECTORS = _sectors()


def maximisers(pairs: Pairs, start: Float[Array, "3 N"], thorough: bool = True) -> Float[Array, "3 N"]:
    """Maximisers of F, (3, N) unit.

    Three passes through one loop over blocks of pairs: all pairs, until few of a block are left; those that were left;
    and the further starts of overlapping pairs.

    Args:
        pairs: the problems.
        start: (3, N) directions to start from; where zero, `first_guess` is taken.
        thorough: climb overlapping pairs also from the best direction of each of six sectors of the sphere.
    """
    count = start.shape[1]
    lanes = -(-count // -(-count // BLOCK))
    sectors = jnp.asarray(SECTORS)
    per_pair = sectors.shape[2]
    last = jnp.maximum(pairs.sharpness_a, pairs.sharpness_b)
    reach_a, reach_b = (jnp.sqrt((offsets**2).sum(0).max(0)) for offsets in (pairs.offsets_a, pairs.offsets_b))
    size = reach_a + reach_b

    def one_pass(index: Int[Array, ""], state: _Found) -> _Found:
        late, deep = ~state.done, state.value < 0
        queue = jnp.where(index == 0, True, jnp.where(index == 1, late, deep))
        total = queue.sum() * jnp.where(index == 2, per_pair, 1)
        queue = jnp.nonzero(queue, size=count, fill_value=0)[0]
        patience = jnp.where(index == 0, lanes // 8, 0)

        def block(progress: tuple[Int[Array, ""], _Found]) -> tuple[Int[Array, ""], _Found]:
            item, state = progress
            job = item + jnp.arange(lanes)
            live = job < total
            pair = queue[jnp.minimum(jnp.where(index == 2, job // per_pair, job), count - 1)]
            some = jax.tree.map(lambda leaf: leaf[..., pair], pairs)
            begin, stage = state.x[:, pair], state.stage[pair]
            if thorough:
                grid = sectors[:, :, job % per_pair]
                best = hull_value(some, grid).argmax(0)
                fresh = jnp.take_along_axis(grid, best[None, None], axis=1)[:, 0]
                begin = jnp.where(index == 2, fresh, begin)
                stage = jnp.where(index == 2, FIRST_SHARPNESS, stage)
            ascent = climb(partial(tangent_model, some), size[pair], last[pair], begin, stage, live, patience)
            kept = jnp.where(index == 2, state.value, -jnp.inf)
            reached = jnp.where(live, ascent.model.value, -jnp.inf)
            value = kept.at[pair].max(reached)
            wins = jnp.where(live & (reached >= value[pair]), pair, count)
            return item + lanes, _Found(
                state.x.at[:, wins].set(ascent.x, mode="drop"),
                jnp.where(jnp.isneginf(value), state.value, value),
                state.stage.at[wins].set(ascent.stage, mode="drop"),
                state.done.at[wins].set(ascent.done, mode="drop"),
            )

        return jax.lax.while_loop(lambda p: p[0] < total, block, (jnp.zeros((), total.dtype), state))[1]

    given = (start * start).sum(0) > 0
    begin = _Found(
        jnp.where(given, unit(start), first_guess(pairs)),
        jnp.full(count, -jnp.inf),
        jnp.full(count, FIRST_SHARPNESS),
        jnp.zeros(count, bool),
    )
    return jax.lax.fori_loop(0, 3 if thorough else 2, one_pass, begin).x


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Found:
    x: Float[Array, "3 N"]
    value: Float[Array, " N"]
    stage: Float[Array, " N"]
    done: Bool[Array, " N"]
