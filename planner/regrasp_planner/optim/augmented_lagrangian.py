"""Constrained minimisation on a manifold: augmented Lagrangian over a Riemannian trust region (outer loop of Alg. 1).

Inner and outer iterations share one flat loop, whose body evaluates the problem once: `jax.vmap` over starts runs them
in lockstep, and a rejected step costs one evaluation like any other. An evaluation returns the Jacobian of objective
and constraints (forward mode over the few tangent directions). So multiplier updates need no evaluation of their own,
and the curvature of the penalty, ρ JᵀJ, is exact: BFGS models only the Hessian of the Lagrangian, which does not grow
with the penalty.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from regrasp_planner.optim.bfgs import bfgs_update
from regrasp_planner.optim.manifold import Manifold, Point
from regrasp_planner.optim.trust_region import Step, judge, propose

MAX_RADIUS = 2.0
"""Largest trust radius, in the metric of the manifold."""
MAX_PENALTY, PENALTY_GROWTH = 1e8, 10.0
ENOUGH_PROGRESS = 0.25
"""A penalty grows unless the violation of its constraint fell to this share between multiplier updates."""

Problem = Callable[[Point, Any], tuple[Float[Array, ""], Float[Array, " E"], Float[Array, " I"]]]
"""``problem(point, params)`` → objective (), equalities (E,) = 0, inequalities (I,) ≥ 0."""


class Status(IntEnum):
    """How a solver ended."""

    RUNNING = 0
    CONVERGED = 1
    """First-order conditions hold within the tolerances."""
    STALLED = 2
    """The objective fell more slowly than `Stall` asks for; the constraints hold."""
    INFEASIBLE = 3
    """Penalties are at their limit and constraints are still violated."""
    BUDGET = 4
    """No evaluations were left."""
    NOT_FINITE = 5
    """The problem was not finite at the start."""


class Stall(NamedTuple):
    """Early stop at a feasible point: ``steps`` accepted steps in a row, each lowering f by less than ``decrease``."""

    decrease: float
    steps: int


NEVER = Stall(decrease=0.0, steps=1)


@dataclass(frozen=True)
class Options:
    """When `augmented_lagrangian` stops, and how it begins.

    Attributes:
        max_evaluations: most evaluations of the problem.
        max_inner: evaluations after which the multipliers are updated, converged or not.
        constraint_tolerance: largest violation of a feasible point, in the problem's units.
        gradient_tolerance: norm of the Lagrangian's gradient to stop at.
        stall: when to stop early; never by default.
        initial_penalty: ρ at the start.
        initial_radius: trust radius at the start, in the metric of the manifold.
    """

    max_evaluations: int = 150
    max_inner: int = 20
    constraint_tolerance: float = 1e-6
    gradient_tolerance: float = 1e-6
    stall: Stall = NEVER
    initial_penalty: float = 10.0
    initial_radius: float = 0.3


class Multipliers(NamedTuple):
    """λ (E,) of the equalities and λ ≥ 0 (I,) of the inequalities, for the Lagrangian f − λ·c."""

    equalities: Float[Array, " E"]
    inequalities: Float[Array, " I"]


class ConstrainedResult(NamedTuple):
    """Outcome of `augmented_lagrangian`.

    Attributes:
        point: final point; if that is infeasible, the best feasible point seen, or else the least violating one.
        value: () objective there.
        equalities: (E,) there, in the problem's units.
        inequalities: (I,) there.
        multipliers: of the Lagrangian.
        violation: () largest of |equalities| and −inequalities, at least 0.
        evaluations: () evaluations of the problem.
        status: () a `Status`.
    """

    point: Point
    value: Float[Array, ""]
    equalities: Float[Array, " E"]
    inequalities: Float[Array, " I"]
    multipliers: Multipliers
    violation: Float[Array, ""]
    evaluations: Int[Array, ""]
    status: Int[Array, ""]


class _Sample(NamedTuple):
    """The problem at a point: values f, c (equalities first) and their derivatives in tangent coordinates."""

    value: Float[Array, ""]
    constraints: Float[Array, " m"]
    slope: Float[Array, " d"]
    jacobian: Float[Array, "m d"]


class _Iterate(NamedTuple):
    point: Point
    sample: _Sample


class _Dual(NamedTuple):
    """Multipliers λ, penalties ρ, and the violations when both were last updated."""

    multipliers: Float[Array, " m"]
    penalties: Float[Array, " m"]
    violations: Float[Array, " m"]


class _Counts(NamedTuple):
    """Evaluations in all and since the last multiplier update, such updates, BFGS updates, stalled steps."""

    evaluations: Int[Array, ""]
    inner: Int[Array, ""]
    outer: Int[Array, ""]
    learned: Int[Array, ""]
    stalled: Int[Array, ""]


class _State(NamedTuple):
    trial: Point
    step: Step
    current: _Iterate
    best: _Iterate
    dual: _Dual
    hessian: Float[Array, "d d"]
    radius: Float[Array, ""]
    counts: _Counts
    status: Int[Array, ""]


_Kinds = Bool[np.ndarray, " m"]
"""Which constraints are equalities."""


def augmented_lagrangian(
    problem: Problem,
    start: Point,
    manifold: Manifold,
    options: Options = Options(),
    *,
    params: Any = (),
    counts: tuple[int, int] | None = None,
) -> ConstrainedResult:
    """Minimise f subject to c_E = 0 and c_I ≥ 0 (Powell, Hestenes, Rockafellar; Nocedal & Wright, framework 17.3).

    The merit function is f + Σ_E (−λc + ½ρc²) + Σ_I (max(0, λ − ρc)² − λ²)/2ρ with a multiplier and a penalty of
    its own per constraint. Scale the problem so that f and the constraints change by about 1 over the region of
    interest.

    Args:
        problem: ``problem(point, params)`` → (objective, equalities (E,), inequalities (I,)); E or I may be 0. It is
            traced once inside the loop and differentiated in forward mode: functions with only a custom reverse rule
            do not work.
        start: first point.
        manifold: where the points live, dimension d.
        options: when to stop and how to begin.
        params: arrays handed to the problem, so that it needs no closure over changing data.
        counts: numbers (E, I) of constraints; without them the problem is traced once more to find out.

    Returns:
        `ConstrainedResult`. Never raises on numerical trouble; see ``status``.
    """
    start = jax.tree.map(jnp.asarray, start)
    if counts is None:
        _, equalities, inequalities = jax.eval_shape(problem, start, params)
        counts = equalities.shape[0], inequalities.shape[0]
    kinds = np.arange(sum(counts)) < counts[0]

    def evaluate(point: Point) -> _Sample:
        def flat(xi: Float[Array, " d"]) -> Float[Array, " m1"]:
            value, equalities, inequalities = problem(manifold.retract(point, xi), params)
            return jnp.concatenate([value[None], equalities, inequalities])

        values, push = jax.linearize(flat, jnp.zeros(manifold.dim))
        rows = jax.vmap(push, out_axes=1)(jnp.eye(manifold.dim))
        return _Sample(values[0], values[1:], rows[0], rows[1:])

    def advance(state: _State) -> _State:
        return _advance(state, evaluate(state.trial), manifold, kinds, options)

    begin = _beginning(start, manifold.dim, len(kinds), options)
    end = jax.lax.while_loop(lambda state: state.status == Status.RUNNING, advance, begin)
    keep = _feasible(end.current.sample, kinds, options) & jnp.isfinite(end.current.sample.value)
    point, sample = _select(keep, end.current, end.best)
    return ConstrainedResult(
        point=point,
        value=sample.value,
        equalities=sample.constraints[: counts[0]],
        inequalities=sample.constraints[counts[0] :],
        multipliers=Multipliers(end.dual.multipliers[: counts[0]], end.dual.multipliers[counts[0] :]),
        violation=_worst(sample, kinds),
        evaluations=end.counts.evaluations,
        status=end.status,
    )


def _beginning(start: Point, dim: int, count: int, options: Options) -> _State:
    """The state before the first evaluation; any first sample that is finite is better than its own."""
    zero = jnp.asarray(0)
    nothing = _Sample(jnp.full((), jnp.inf), jnp.zeros(count), jnp.zeros(dim), jnp.zeros((count, dim)))
    state = _State(
        trial=start,
        step=Step(jnp.zeros(dim), jnp.zeros(()), jnp.asarray(False)),
        current=_Iterate(start, nothing),
        best=_Iterate(start, nothing),
        dual=_Dual(jnp.zeros(count), jnp.full(count, float(options.initial_penalty)), jnp.full(count, jnp.inf)),
        hessian=jnp.eye(dim),
        radius=jnp.asarray(options.initial_radius, float),
        counts=_Counts(zero, zero, zero, zero, zero),
        status=jnp.asarray(int(Status.RUNNING)),
    )
    # Under vmap the loop's body is traced anew until it is known which parts of the state differ from start to start.
    # All do in the end. Tying each part to the start says so from the beginning, and halves the time to trace.
    never = jnp.logical_and(jax.tree.leaves(start)[0].ravel()[0] > 0, False)
    return jax.tree.map(lambda leaf: jnp.where(never, jnp.zeros_like(leaf), leaf), state)


def _advance(state: _State, fresh: _Sample, manifold: Manifold, kinds: _Kinds, options: Options) -> _State:
    """Judge the trial point by its sample, update multipliers if it is time, and propose the next trial point."""
    counts, dual = state.counts, state.dual
    first = counts.evaluations == 0
    usable = jnp.isfinite(fresh.value) & jnp.isfinite(fresh.constraints).all()
    usable = usable & jnp.isfinite(fresh.slope).all() & jnp.isfinite(fresh.jacobian).all()

    after = jnp.where(usable, _merit(fresh, dual, kinds), jnp.nan)
    good, radius = judge(state.step, _merit(state.current.sample, dual, kinds), after, state.radius, MAX_RADIUS)
    accepted = usable & (first | good)
    radius = jnp.where(first, state.radius, radius)
    learns = usable & ~first & (jnp.linalg.norm(state.step.tangent) > 0)
    hessian = _select(learns, _learned(state, fresh, kinds), state.hessian)
    trial = _Iterate(state.trial, fresh)
    current = _select(accepted, trial, state.current)
    improves = usable & (first | _better(fresh, state.best.sample, kinds, options))

    sample = current.sample
    estimates = _estimates(sample, dual, kinds)
    grad_norm = jnp.linalg.norm(sample.slope - estimates @ sample.jacobian)
    inner = counts.inner + 1
    # Inner problems are solved the more exactly the closer the end (Nocedal & Wright, algorithm 17.4).
    goal = jnp.maximum(options.gradient_tolerance, 0.1 * 0.2**counts.outer)
    update = (grad_norm <= goal) | (inner >= options.max_inner) | (radius < 1e-10)
    updated, exhausted = _updated(dual, sample, estimates, kinds, options)
    dual = _select(update, updated, dual)
    radius = jnp.where(update, jnp.maximum(radius, 0.25 * options.initial_radius), radius)

    feasible = _feasible(sample, kinds, options)
    gain = state.current.sample.value - sample.value
    idle = accepted & ~first & feasible & (jnp.abs(gain) < options.stall.decrease)
    stalled = jnp.where(idle, counts.stalled + 1, jnp.where(accepted, 0, counts.stalled))
    step = _proposed(sample, dual, hessian, radius, kinds)
    evaluations = counts.evaluations + 1
    status = jnp.select(
        [
            first & ~usable,
            update & feasible & (grad_norm <= options.gradient_tolerance),
            stalled >= options.stall.steps,
            update & exhausted & (counts.outer > 3) & ~feasible,
            evaluations >= options.max_evaluations,
        ],
        [Status.NOT_FINITE, Status.CONVERGED, Status.STALLED, Status.INFEASIBLE, Status.BUDGET],
        Status.RUNNING,
    )
    return _State(
        trial=manifold.retract(current.point, step.tangent),
        step=step,
        current=current,
        best=_select(improves, trial, state.best),
        dual=dual,
        hessian=hessian,
        radius=radius,
        counts=_Counts(
            evaluations, jnp.where(update, 0, inner), counts.outer + update, counts.learned + learns, stalled
        ),
        status=status,
    )


def _learned(state: _State, fresh: _Sample, kinds: _Kinds) -> Float[Array, "d d"]:
    """BFGS model of the Lagrangian's Hessian after the trial step.

    The multipliers are the estimates at the trial point: unlike the merit's, this Hessian does not carry ρ JᵀJ.
    """
    old = state.current.sample
    estimates = _estimates(fresh, state.dual, kinds)
    change = (fresh.slope - estimates @ fresh.jacobian) - (old.slope - estimates @ old.jacobian)
    return bfgs_update(state.hessian, state.step.tangent, change, first=state.counts.learned == 0)


def _updated(
    dual: _Dual, sample: _Sample, estimates: Float[Array, " m"], kinds: _Kinds, options: Options
) -> tuple[_Dual, Bool[Array, ""]]:
    """Multipliers and penalties for the next inner problem, and whether a penalty that should grow cannot."""
    # For an inactive inequality what has to vanish is the product of multiplier and slack.
    slack = jnp.where(kinds, 0.0, jnp.minimum(jnp.abs(sample.constraints), dual.multipliers / dual.penalties))
    seen = jnp.maximum(_violations(sample, kinds), slack)
    poor = (seen > ENOUGH_PROGRESS * dual.violations) & (seen > options.constraint_tolerance)
    penalties = jnp.where(poor, jnp.minimum(dual.penalties * PENALTY_GROWTH, MAX_PENALTY), dual.penalties)
    return _Dual(estimates, penalties, seen), jnp.any(poor & (dual.penalties >= MAX_PENALTY))


def _proposed(
    sample: _Sample, dual: _Dual, hessian: Float[Array, "d d"], radius: Float[Array, ""], kinds: _Kinds
) -> Step:
    """Trust-region step on the merit function; only active constraints bend it."""
    estimates = _estimates(sample, dual, kinds)
    active = kinds | (estimates > 0)
    curvature = hessian + (sample.jacobian.T * jnp.where(active, dual.penalties, 0.0)) @ sample.jacobian
    return propose(sample.slope - estimates @ sample.jacobian, curvature, radius)


def _estimates(sample: _Sample, dual: _Dual, kinds: _Kinds) -> Float[Array, " m"]:
    """First-order multiplier estimates: λ − ρc, not below zero for inequalities."""
    shifted = dual.multipliers - dual.penalties * sample.constraints
    return jnp.where(kinds, shifted, jnp.maximum(shifted, 0.0))


def _merit(sample: _Sample, dual: _Dual, kinds: _Kinds) -> Float[Array, ""]:
    estimates = _estimates(sample, dual, kinds)
    return sample.value + jnp.sum((estimates**2 - dual.multipliers**2) / (2.0 * dual.penalties))


def _violations(sample: _Sample, kinds: _Kinds) -> Float[Array, " m"]:
    return jnp.where(kinds, jnp.abs(sample.constraints), jnp.maximum(-sample.constraints, 0.0))


def _worst(sample: _Sample, kinds: _Kinds) -> Float[Array, ""]:
    return jnp.max(_violations(sample, kinds), initial=0.0)


def _feasible(sample: _Sample, kinds: _Kinds, options: Options) -> Bool[Array, ""]:
    return _worst(sample, kinds) <= options.constraint_tolerance


def _better(new: _Sample, old: _Sample, kinds: _Kinds, options: Options) -> Bool[Array, ""]:
    """Feasible before infeasible, then the lower objective or the smaller violation."""
    new_ok, old_ok = _feasible(new, kinds, options), _feasible(old, kinds, options)
    lower = jnp.where(new_ok, new.value < old.value, _worst(new, kinds) < _worst(old, kinds))
    return jnp.where(new_ok == old_ok, lower, new_ok)


def _select[T](condition: Bool[Array, ""], new: T, old: T) -> T:
    """Leaf by leaf ``new`` where the condition holds, else ``old``."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), new, old)
