"""Riemannian trust region with the truncated conjugate gradients of Steihaug and Toint.

The loop evaluates first and proposes afterwards, so that the objective is traced once, and rejected steps cost one
evaluation like any other. Everything is fixed-shape and free of Python branches on values: `jax.vmap` over starts
runs them in lockstep, and each reports how it ended in a status code.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from regrasp_planner.optim.bfgs import bfgs_update
from regrasp_planner.optim.manifold import Manifold, Point


class Status(IntEnum):
    """How a solver ended."""

    RUNNING = 0
    CONVERGED = 1
    """First-order conditions hold within the tolerances."""
    STALLED = 2
    """No further progress can be made in floating point, or it fell below the requested rate; constraints hold."""
    INFEASIBLE = 3
    """Penalties at their limit, or no progress, with constraints still violated."""
    BUDGET = 4
    """The cap on evaluations was reached."""
    NOT_FINITE = 5
    """The function was not finite at the start."""


class Result(NamedTuple):
    """Outcome of `trust_region`.

    Attributes:
        point: best point found.
        value: () objective there.
        gradient: (d,) Riemannian gradient there, in tangent coordinates.
        grad_norm: () its norm.
        iterations: () accepted steps.
        evaluations: () evaluations of the objective with its derivatives.
        status: () a `Status`.
    """

    point: Point
    value: Float[Array, ""]
    gradient: Float[Array, " d"]
    grad_norm: Float[Array, ""]
    iterations: Int[Array, ""]
    evaluations: Int[Array, ""]
    status: Int[Array, ""]


# Conn, Gould, Toint, *Trust-Region Methods*, §17.1: any 0 < accept < shrink < grow < 1 converges.
ACCEPT_RATIO, SHRINK_RATIO, GROW_RATIO = 0.05, 0.25, 0.75


def truncated_cg(
    gradient: Float[Array, " d"], hessian: Float[Array, "d d"], radius: Float[Array, ""]
) -> tuple[Float[Array, " d"], Bool[Array, ""]]:
    """Approximate minimiser of gᵀs + ½ sᵀHs within ‖s‖ ≤ radius (Steihaug 1983, Toint 1981).

    Conjugate gradients, stopped at the boundary when a step leaves the region or the curvature is not positive.

    Args:
        gradient: (d,) g.
        hessian: (d, d) symmetric H, possibly indefinite.
        radius: () trust radius.

    Returns:
        (d,) step and whether it ends on the boundary.
    """
    dim = gradient.shape[0]
    norm0 = jnp.linalg.norm(gradient)
    # Superlinear rate near the solution (residual falls with the gradient), a rough solve far from it.
    goal = norm0 * jnp.minimum(0.05, norm0)

    def body(_: Any, carry: Any) -> Any:
        step, residual, direction, square, done, _ = carry
        image = hessian @ direction
        curvature = direction @ image
        alpha = square / jnp.where(curvature > 0, curvature, 1.0)
        longer = step + alpha * direction
        leaves = (curvature <= 0) | (longer @ longer >= radius**2)
        # Positive root of ‖step + τ direction‖ = radius, written without cancellation.
        a, b, c = direction @ direction, step @ direction, step @ step - radius**2
        root = jnp.sqrt(jnp.maximum(b * b - a * c, 0.0))
        tau = jnp.where(b > 0, -c / jnp.where(b > 0, b + root, 1.0), (root - b) / jnp.where(a > 0, a, 1.0))
        new_step = jnp.where(leaves, step + tau * direction, longer)
        new_residual = residual + alpha * image
        new_square = new_residual @ new_residual
        beta = new_square / jnp.where(square > 0, square, 1.0)
        new_direction = -new_residual + beta * direction
        small = jnp.sqrt(new_square) <= goal
        fresh = (new_step, new_residual, new_direction, new_square, leaves | small, leaves)
        return jax.tree.map(lambda new, old: jnp.where(done, old, new), fresh, carry)

    start = (jnp.zeros(dim), gradient, -gradient, gradient @ gradient, norm0 == 0.0, jnp.asarray(False))
    step, _, _, _, _, hit = jax.lax.fori_loop(0, 2 * dim, body, start)
    return step, hit


def next_radius(
    ratio: Float[Array, ""],
    radius: Float[Array, ""],
    step_norm: Float[Array, ""],
    hit: Bool[Array, ""],
    max_radius: float,
) -> Float[Array, ""]:
    """Trust radius after a step whose actual reduction was ``ratio`` times the predicted one."""
    shrunk = 0.25 * jnp.minimum(radius, step_norm)
    grown = jnp.minimum(2.0 * radius, max_radius)
    return jnp.where(ratio < SHRINK_RATIO, shrunk, jnp.where((ratio > GROW_RATIO) & hit, grown, radius))


def reduction_ratio(before: Float[Array, ""], after: Float[Array, ""], predicted: Float[Array, ""]) -> Float[Array, ""]:
    """Actual over predicted reduction, both regularised by the rounding error of the values; −1 if not finite."""
    rounding = 1e3 * jnp.finfo(before.dtype).eps * jnp.maximum(1.0, jnp.abs(before))
    ratio = (before - after + rounding) / (predicted + rounding)
    return jnp.where(jnp.isfinite(after), ratio, -1.0)


def select(condition: Bool[Array, ""], new: Any, old: Any) -> Any:
    """Leaf by leaf ``new`` where the condition holds, else ``old``."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), new, old)


class _State(NamedTuple):
    trial: Point
    step: Float[Array, " d"]
    predicted: Float[Array, ""]
    hit: Bool[Array, ""]
    point: Point
    value: Float[Array, ""]
    gradient: Float[Array, " d"]
    hessian: Float[Array, "d d"]
    radius: Float[Array, ""]
    iterations: Int[Array, ""]
    evaluations: Int[Array, ""]
    updates: Int[Array, ""]
    status: Int[Array, ""]


def trust_region(
    objective: Callable[[Point, Any], Float[Array, ""]],
    start: Point,
    manifold: Manifold,
    *,
    params: Any = (),
    hessian: Literal["exact", "bfgs"] = "bfgs",
    max_evaluations: int = 200,
    tolerance: float = 1e-8,
    initial_radius: float = 0.5,
    max_radius: float = 3.0,
) -> Result:
    """Minimise a smooth function on a manifold (Absil, Baker, Gallivan 2007; with ``bfgs`` the solver of Alg. 1).

    Args:
        objective: ``objective(point, params)`` → scalar. With ``hessian="exact"`` it is differentiated twice
            (forward over reverse), with ``"bfgs"`` once in reverse mode.
        start: first point.
        manifold: where the points live.
        params: arrays handed to the objective, so that it needs no closure over changing data.
        hessian: exact Riemannian Hessian (d Hessian-vector products in one batch per evaluation), or a BFGS model.
        max_evaluations: cap on evaluations of the objective.
        tolerance: norm of the gradient to stop at.
        initial_radius, max_radius: of the trust region, in the metric of the manifold.

    Returns:
        `Result`. Never raises on numerical trouble; see ``status``.
    """
    dim = manifold.dim

    def trivialised(point: Point) -> Callable[[Float[Array, " d"]], tuple[Float[Array, ""], Float[Array, " d"]]]:
        return jax.value_and_grad(lambda xi: objective(manifold.retract(point, xi), params))

    def evaluate(point: Point) -> tuple[Float[Array, ""], Float[Array, " d"], Float[Array, "d d"]]:
        zero = jnp.zeros(dim)
        if hessian == "bfgs":
            value, gradient = trivialised(point)(zero)
            return value, gradient, jnp.eye(dim)
        (value, gradient), push = jax.linearize(trivialised(point), zero)
        _, rows = jax.vmap(push)(jnp.eye(dim))
        return value, gradient, 0.5 * (rows + rows.T)

    def body(state: _State) -> _State:
        value, gradient, exact = evaluate(state.trial)
        first = state.evaluations == 0
        usable = jnp.isfinite(value) & jnp.isfinite(gradient).all() & jnp.isfinite(exact).all()
        ratio = reduction_ratio(state.value, jnp.where(usable, value, jnp.nan), state.predicted)
        accepted = usable & (first | (ratio > ACCEPT_RATIO))
        step_norm = jnp.linalg.norm(state.step)
        radius = jnp.where(first, state.radius, next_radius(ratio, state.radius, step_norm, state.hit, max_radius))

        updates = state.updates
        if hessian == "bfgs":
            turn = manifold.transport(state.point, state.step, state.trial)
            learn = usable & ~first & (step_norm > 0)
            change = turn.T @ gradient - state.gradient
            model = select(learn, bfgs_update(state.hessian, state.step, change, first=updates == 0), state.hessian)
            updates = updates + learn
            model = jnp.where(accepted, turn @ model @ turn.T, model)
            model = jnp.where(first, jnp.eye(dim), model)
        else:
            model = jnp.where(accepted, exact, state.hessian)
        point = select(accepted, state.trial, state.point)
        value = jnp.where(accepted, value, state.value)
        gradient = jnp.where(accepted, gradient, state.gradient)

        step, hit = truncated_cg(gradient, model, radius)
        predicted = -(gradient @ step + 0.5 * step @ model @ step)
        evaluations = state.evaluations + 1
        # A radius or predicted gain below rounding means no trial could be told from the current point.
        exhausted = (radius < 1e-12) | (predicted <= 1e-3 * jnp.finfo(value.dtype).eps * jnp.abs(value))
        status = jnp.select(
            [first & ~usable, jnp.linalg.norm(gradient) <= tolerance, exhausted, evaluations >= max_evaluations],
            [Status.NOT_FINITE, Status.CONVERGED, Status.STALLED, Status.BUDGET],
            Status.RUNNING,
        )
        return _State(
            trial=manifold.retract(point, step),
            step=step,
            predicted=predicted,
            hit=hit,
            point=point,
            value=value,
            gradient=gradient,
            hessian=model,
            radius=radius,
            iterations=state.iterations + (accepted & ~first),
            evaluations=evaluations,
            updates=updates,
            status=status,
        )

    start = jax.tree.map(jnp.asarray, start)
    zero, count = jnp.zeros(()), jnp.asarray(0)
    state = _State(
        trial=start,
        step=jnp.zeros(dim),
        predicted=zero,
        hit=jnp.asarray(False),
        point=start,
        value=jnp.full((), jnp.inf),
        gradient=jnp.zeros(dim),
        hessian=jnp.eye(dim),
        radius=jnp.asarray(initial_radius, float),
        iterations=count,
        evaluations=count,
        updates=count,
        status=jnp.asarray(int(Status.RUNNING)),
    )
    end = jax.lax.while_loop(lambda s: s.status == Status.RUNNING, body, state)
    return Result(
        end.point, end.value, end.gradient, jnp.linalg.norm(end.gradient), end.iterations, end.evaluations, end.status
    )
