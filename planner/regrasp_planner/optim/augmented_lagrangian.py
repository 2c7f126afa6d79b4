"""Constrained minimisation on a manifold: augmented Lagrangian over a Riemannian trust region (outer loop of Alg. 1).

Inner and outer iterations share one flat loop, whose body evaluates the problem once. The evaluation returns the
Jacobian of objective and constraints together (forward mode over the few tangent directions), which buys two things:
multiplier updates need no evaluation of their own, and the curvature of the penalty, ρ JᵀJ, is known exactly, so that
only the curvature of the Lagrangian, which does not grow with the penalty, is left to the BFGS model.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from regrasp_planner.optim.bfgs import bfgs_update
from regrasp_planner.optim.manifold import Manifold, Point
from regrasp_planner.optim.trust_region import (
    ACCEPT_RATIO,
    Status,
    next_radius,
    reduction_ratio,
    select,
    truncated_cg,
)

Problem = Callable[[Point, Any], tuple[Float[Array, ""], Float[Array, " E"], Float[Array, " I"]]]
"""``problem(point, params)`` → objective (), equalities (E,) = 0, inequalities (I,) ≥ 0."""


class ConstrainedResult(NamedTuple):
    """Outcome of `augmented_lagrangian`.

    Attributes:
        point: final point; if that is not feasible, the best feasible or else the least violating one seen.
        value: () objective there.
        equalities: (E,) there, in the problem's units.
        inequalities: (I,) there.
        violation: () max of |equalities| and −inequalities there, at least 0.
        grad_norm: () norm of the Riemannian gradient of the Lagrangian at the final iterate.
        equality_multipliers: (E,) λ of the Lagrangian f − λ·c.
        inequality_multipliers: (I,) λ ≥ 0.
        evaluations: () evaluations of the problem.
        outer_iterations: () multiplier updates.
        status: () a `Status`.
    """

    point: Point
    value: Float[Array, ""]
    equalities: Float[Array, " E"]
    inequalities: Float[Array, " I"]
    violation: Float[Array, ""]
    grad_norm: Float[Array, ""]
    equality_multipliers: Float[Array, " E"]
    inequality_multipliers: Float[Array, " I"]
    evaluations: Int[Array, ""]
    outer_iterations: Int[Array, ""]
    status: Int[Array, ""]


class _Sample(NamedTuple):
    """The problem at a point: values f, c (equalities first) and their rows of derivatives in tangent coordinates."""

    value: Float[Array, ""]
    constraints: Float[Array, " m"]
    slope: Float[Array, " d"]
    jacobian: Float[Array, "m d"]


class _State(NamedTuple):
    trial: Point
    step: Float[Array, " d"]
    predicted: Float[Array, ""]
    hit: Bool[Array, ""]
    point: Point
    sample: _Sample
    best: Point
    best_sample: _Sample
    multipliers: Float[Array, " m"]
    penalties: Float[Array, " m"]
    last_violation: Float[Array, " m"]
    hessian: Float[Array, "d d"]
    radius: Float[Array, ""]
    inner: Int[Array, ""]
    outer: Int[Array, ""]
    updates: Int[Array, ""]
    stalled: Int[Array, ""]
    evaluations: Int[Array, ""]
    grad_norm: Float[Array, ""]
    status: Int[Array, ""]


def augmented_lagrangian(
    problem: Problem,
    start: Point,
    manifold: Manifold,
    *,
    params: Any = (),
    counts: tuple[int, int] | None = None,
    max_evaluations: int = 150,
    max_inner: int = 20,
    constraint_tolerance: float = 1e-6,
    gradient_tolerance: float = 1e-6,
    initial_penalty: float | Float[Array, " m"] = 10.0,
    max_penalty: float = 1e8,
    penalty_growth: float = 10.0,
    shrink: float = 0.25,
    initial_radius: float = 0.3,
    max_radius: float = 2.0,
    stall_decrease: float = 0.0,
    stall_steps: int = 5,
) -> ConstrainedResult:
    """Minimise f subject to c_E = 0 and c_I ≥ 0 (Powell, Hestenes, Rockafellar; Nocedal & Wright, framework 17.3).

    The merit function is f + Σ_E (−λc + ½ρc²) + Σ_I (max(0, λ − ρc)² − λ²)/2ρ with a multiplier and a penalty of
    its own per constraint. A penalty grows only where the constraint's violation did not fall to ``shrink`` times what
    it was. Scale the problem so that f and the constraints change by about 1 over the region of interest.

    Args:
        problem: ``problem(point, params)`` → (objective, equalities (E,), inequalities (I,)); E or I may be 0. It is
            traced once inside the loop and differentiated in forward mode: functions with only a custom reverse rule
            do not work.
        start: first point.
        manifold: where the points live, dimension d.
        params: arrays handed to the problem, so that it needs no closure over changing data.
        counts: numbers (E, I) of constraints; without them the problem is traced once more to find out.
        max_evaluations: cap on evaluations of the problem.
        max_inner: evaluations after which the multipliers are updated, converged or not.
        constraint_tolerance: largest violation of a feasible point, in the problem's units.
        gradient_tolerance: norm of the Lagrangian's gradient to stop at.
        initial_penalty: ρ at the start, one number or one per constraint (equalities first).
        max_penalty: ρ grows no further.
        penalty_growth: factor of growth.
        shrink: ratio of violations between multiplier updates that counts as progress.
        initial_radius, max_radius: of the trust region, in the metric of the manifold.
        stall_decrease: with a positive value, stop early at a feasible point once ``stall_steps`` evaluations in
            a row lowered the objective by less than this each.
        stall_steps: see ``stall_decrease``.

    Returns:
        `ConstrainedResult`. Never raises on numerical trouble; see ``status``.
    """
    dim = manifold.dim
    start = jax.tree.map(jnp.asarray, start)
    if counts is None:
        _, eq_shape, ineq_shape = jax.eval_shape(problem, start, params)
        counts = eq_shape.shape[0], ineq_shape.shape[0]
    n_eq, n_ineq = counts
    count = n_eq + n_ineq
    is_eq = jnp.arange(count) < n_eq

    def evaluate(point: Point) -> _Sample:
        def flat(xi: Float[Array, " d"]) -> Float[Array, " m1"]:
            value, eq, ineq = problem(manifold.retract(point, xi), params)
            return jnp.concatenate([value[None], eq, ineq])

        values, push = jax.linearize(flat, jnp.zeros(dim))
        rows = jax.vmap(push, out_axes=1)(jnp.eye(dim))
        return _Sample(values[0], values[1:], rows[0], rows[1:])

    def estimates(c: Float[Array, " m"], lam: Float[Array, " m"], rho: Float[Array, " m"]) -> Float[Array, " m"]:
        """First-order multiplier estimates: λ − ρc, not below zero for inequalities."""
        shifted = lam - rho * c
        return jnp.where(is_eq, shifted, jnp.maximum(shifted, 0.0))

    def merit(sample: _Sample, lam: Float[Array, " m"], rho: Float[Array, " m"]) -> Float[Array, ""]:
        new = estimates(sample.constraints, lam, rho)
        return sample.value + jnp.sum((new**2 - lam**2) / (2.0 * rho))

    def violations(c: Float[Array, " m"]) -> Float[Array, " m"]:
        return jnp.where(is_eq, jnp.abs(c), jnp.maximum(-c, 0.0))

    def worst(c: Float[Array, " m"]) -> Float[Array, ""]:
        return jnp.max(violations(c), initial=0.0)

    def better(new: _Sample, old: _Sample) -> Bool[Array, ""]:
        """Feasible before infeasible, then the lower objective or the smaller violation."""
        new_worst, old_worst = worst(new.constraints), worst(old.constraints)
        new_ok, old_ok = new_worst <= constraint_tolerance, old_worst <= constraint_tolerance
        lower = jnp.where(new_ok, new.value < old.value, new_worst < old_worst)
        return jnp.where(new_ok == old_ok, lower, new_ok)

    def body(state: _State) -> _State:
        fresh = evaluate(state.trial)
        first = state.evaluations == 0
        usable = jnp.isfinite(fresh.value) & jnp.isfinite(fresh.constraints).all()
        usable = usable & jnp.isfinite(fresh.slope).all() & jnp.isfinite(fresh.jacobian).all()
        lam, rho = state.multipliers, state.penalties

        before = merit(state.sample, lam, rho)
        after = jnp.where(usable, merit(fresh, lam, rho), jnp.nan)
        ratio = reduction_ratio(before, after, state.predicted)
        accepted = usable & (first | (ratio > ACCEPT_RATIO))
        step_norm = jnp.linalg.norm(state.step)
        radius = jnp.where(first, state.radius, next_radius(ratio, state.radius, step_norm, state.hit, max_radius))

        # Secant pair of the Lagrangian at the new estimates: its Hessian, unlike the merit's, does not carry ρ JᵀJ.
        turn = manifold.transport(state.point, state.step, state.trial)
        dual = estimates(fresh.constraints, lam, rho)
        far = turn.T @ (fresh.slope - dual @ fresh.jacobian)
        near = state.sample.slope - dual @ state.sample.jacobian
        learn = usable & ~first & (step_norm > 0)
        model = bfgs_update(state.hessian, state.step, far - near, first=state.updates == 0)
        model = select(learn, model, state.hessian)
        model = jnp.where(accepted & ~first, turn @ model @ turn.T, model)

        point = select(accepted, state.trial, state.point)
        sample = select(accepted, fresh, state.sample)
        improves = usable & (first | better(fresh, state.best_sample))
        best = select(improves, state.trial, state.best)
        best_sample = select(improves, fresh, state.best_sample)

        # Outer update: all it needs is in the sample.
        dual = estimates(sample.constraints, lam, rho)
        gradient = sample.slope - dual @ sample.jacobian
        grad_norm = jnp.linalg.norm(gradient)
        feasible = worst(sample.constraints) <= constraint_tolerance
        inner = state.inner + 1
        # Inner problems are solved the more exactly the closer the end (Nocedal & Wright, algorithm 17.4).
        goal = jnp.maximum(gradient_tolerance, 0.1 * 0.2**state.outer)
        update = (grad_norm <= goal) | (inner >= max_inner) | (radius < 1e-10)
        seen = violations(sample.constraints)
        # For an inactive inequality what has to vanish is the product of multiplier and slack.
        seen = jnp.maximum(seen, jnp.where(is_eq, 0.0, jnp.minimum(jnp.abs(sample.constraints), lam / rho)))
        poor = (seen > shrink * state.last_violation) & (seen > constraint_tolerance)
        exhausted = jnp.any(poor & (rho >= max_penalty)) & (state.outer > 3)
        grown = jnp.where(poor, jnp.minimum(rho * penalty_growth, max_penalty), rho)
        lam = jnp.where(update, dual, lam)
        rho = jnp.where(update, grown, rho)
        last_violation = jnp.where(update, seen, state.last_violation)
        radius = jnp.where(update, jnp.maximum(radius, 0.25 * initial_radius), radius)
        inner = jnp.where(update, 0, inner)

        gain = state.sample.value - sample.value
        idle = accepted & ~first & feasible & (jnp.abs(gain) < stall_decrease)
        stalled = jnp.where(idle, state.stalled + 1, jnp.where(accepted, 0, state.stalled))

        dual = estimates(sample.constraints, lam, rho)
        active = is_eq | (dual > 0)
        curvature = model + (sample.jacobian.T * jnp.where(active, rho, 0.0)) @ sample.jacobian
        gradient = sample.slope - dual @ sample.jacobian
        step, hit = truncated_cg(gradient, curvature, radius)
        predicted = -(gradient @ step + 0.5 * step @ curvature @ step)

        evaluations = state.evaluations + 1
        status = jnp.select(
            [
                first & ~usable,
                update & feasible & (grad_norm <= gradient_tolerance),
                stalled >= stall_steps,
                update & exhausted & ~feasible,
                evaluations >= max_evaluations,
            ],
            [Status.NOT_FINITE, Status.CONVERGED, Status.STALLED, Status.INFEASIBLE, Status.BUDGET],
            Status.RUNNING,
        )
        return _State(
            trial=manifold.retract(point, step),
            step=step,
            predicted=predicted,
            hit=hit,
            point=point,
            sample=sample,
            best=best,
            best_sample=best_sample,
            multipliers=lam,
            penalties=rho,
            last_violation=last_violation,
            hessian=model,
            radius=radius,
            inner=inner,
            outer=state.outer + update,
            updates=state.updates + learn,
            stalled=stalled,
            evaluations=evaluations,
            grad_norm=grad_norm,
            status=status,
        )

    zero = jnp.asarray(0)
    empty = _Sample(jnp.full((), jnp.inf), jnp.zeros(count), jnp.zeros(dim), jnp.zeros((count, dim)))
    state = _State(
        trial=start,
        step=jnp.zeros(dim),
        predicted=jnp.zeros(()),
        hit=jnp.asarray(False),
        point=start,
        sample=empty,
        best=start,
        best_sample=empty,
        multipliers=jnp.zeros(count),
        penalties=jnp.broadcast_to(jnp.asarray(initial_penalty, float), (count,)),
        last_violation=jnp.full(count, jnp.inf),
        hessian=jnp.eye(dim),
        radius=jnp.asarray(initial_radius, float),
        inner=zero,
        outer=zero,
        updates=zero,
        stalled=zero,
        evaluations=zero,
        grad_norm=jnp.full((), jnp.inf),
        status=jnp.asarray(int(Status.RUNNING)),
    )
    # Under vmap the loop's body is traced anew until it is known which parts of the state differ from start to start.
    # All do in the end; tying each part to the start says so from the beginning, for half the time to trace.
    never = jnp.logical_and(jax.tree.leaves(start)[0].ravel()[0] > 0, False)
    state = jax.tree.map(lambda leaf: jnp.where(never, jnp.zeros_like(leaf), leaf), state)
    end = jax.lax.while_loop(lambda s: s.status == Status.RUNNING, body, state)
    keep = (worst(end.sample.constraints) <= constraint_tolerance) & jnp.isfinite(end.sample.value)
    point = select(keep, end.point, end.best)
    sample = select(keep, end.sample, end.best_sample)
    return ConstrainedResult(
        point=point,
        value=sample.value,
        equalities=sample.constraints[:n_eq],
        inequalities=sample.constraints[n_eq:],
        violation=worst(sample.constraints),
        grad_norm=end.grad_norm,
        equality_multipliers=end.multipliers[:n_eq],
        inequality_multipliers=end.multipliers[n_eq:],
        evaluations=end.evaluations,
        outer_iterations=end.outer,
        status=end.status,
    )
