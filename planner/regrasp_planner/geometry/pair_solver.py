"""Maximisers on S² of the signed-distance function of many body pairs at once.

For bodies A and B the signed distance is the maximum over unit x of

    F(x) = x·(c_B − c_A) − k_A(x) − k_B(−x) − (r_A + r_B)‖x‖,

with c the centres, r the sweeps and k = m S^{1/p} the core of the DSF (see `support`) about the centre. F is of degree
1, so its Riemannian gradient on the sphere is P∇F and its Riemannian Hessian is P∇²F P − F·I. It is concave for
separated bodies (F > 0), where the maximiser is unique. Vertices are turned into world axes once.

A batch goes at the pace of its slowest pair. So pairs are taken in blocks, a block ends when few of it are left, and
those are gathered into further blocks, as are the further starts of overlapping pairs, where F has several maxima.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from regrasp_planner.geometry.ascent import Model, climb, core_terms, quadratic, tangent_basis

FIRST_SHARPNESS = 32.0
"""Sharpness of the first stage: low enough that creases are wide, high enough to save a stage at p = 32."""
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
