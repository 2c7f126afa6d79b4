"""The parts of a trust-region method: the subproblem, and what a trial step says about the radius."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

# Conn, Gould, Toint, *Trust-Region Methods*, §17.1: any 0 < accept < shrink < grow < 1 converges.
ACCEPT_RATIO, SHRINK_RATIO, GROW_RATIO = 0.05, 0.25, 0.75


class Step(NamedTuple):
    """A trial step.

    Attributes:
        tangent: (d,) the step in tangent coordinates.
        predicted: () decrease that the quadratic model predicts.
        on_boundary: () whether the radius limits the step.
    """

    tangent: Float[Array, " d"]
    predicted: Float[Array, ""]
    on_boundary: Bool[Array, ""]


def propose(gradient: Float[Array, " d"], hessian: Float[Array, "d d"], radius: Float[Array, ""]) -> Step:
    """`truncated_cg` step and the decrease it predicts."""
    step, on_boundary = truncated_cg(gradient, hessian, radius)
    return Step(step, -(gradient @ step + 0.5 * step @ hessian @ step), on_boundary)


def judge(
    step: Step, before: Float[Array, ""], after: Float[Array, ""], radius: Float[Array, ""], max_radius: float
) -> tuple[Bool[Array, ""], Float[Array, ""]]:
    """Whether to accept a step, and the next radius.

    The ratio of actual to predicted decrease decides both. Decreases are regularised by the rounding error of the
    values.

    Args:
        step: the trial step.
        before, after: () values at both ends; a value that is not finite refuses the step.
        radius: () trust radius that the step was computed for.
        max_radius: largest radius.
    """
    rounding = 1e3 * jnp.finfo(before.dtype).eps * jnp.maximum(1.0, jnp.abs(before))
    ratio = (before - after + rounding) / (step.predicted + rounding)
    ratio = jnp.where(jnp.isfinite(after), ratio, -1.0)
    shrunk = 0.25 * jnp.minimum(radius, jnp.linalg.norm(step.tangent))
    grown = jnp.where((ratio > GROW_RATIO) & step.on_boundary, jnp.minimum(2.0 * radius, max_radius), radius)
    return ratio > ACCEPT_RATIO, jnp.where(ratio < SHRINK_RATIO, shrunk, grown)


class _Iteration(NamedTuple):
    """Conjugate gradients: residual and its square, search direction, whether to go on."""

    step: Float[Array, " d"]
    residual: Float[Array, " d"]
    direction: Float[Array, " d"]
    square: Float[Array, ""]
    ended: _End


class _End(NamedTuple):
    done: Bool[Array, ""]
    on_boundary: Bool[Array, ""]


def truncated_cg(
    gradient: Float[Array, " d"], hessian: Float[Array, "d d"], radius: Float[Array, ""]
) -> tuple[Float[Array, " d"], Bool[Array, ""]]:
    """Approximate minimiser of gᵀs + ½ sᵀHs within ‖s‖ ≤ radius (Steihaug 1983, Toint 1981).

    Conjugate gradients stop at the boundary when a step leaves the region or the curvature is not positive.

    Args:
        gradient: (d,) g.
        hessian: (d, d) symmetric H, possibly indefinite.
        radius: () trust radius.

    Returns:
        (d,) step and whether it ends on the boundary.
    """
    dim = gradient.shape[0]
    norm0 = jnp.linalg.norm(gradient)
    # Superlinear rate near the solution (the residual falls with the gradient), a rough solve far from it.
    goal = norm0 * jnp.minimum(0.05, norm0)

    def advance(_: int, old: _Iteration) -> _Iteration:
        image = hessian @ old.direction
        curvature = old.direction @ image
        alpha = old.square / jnp.where(curvature > 0, curvature, 1.0)
        longer = old.step + alpha * old.direction
        leaves = (curvature <= 0) | (longer @ longer >= radius**2)
        step = jnp.where(leaves, old.step + _to_boundary(old.step, old.direction, radius) * old.direction, longer)
        residual = old.residual + alpha * image
        square = residual @ residual
        beta = square / jnp.where(old.square > 0, old.square, 1.0)
        small = jnp.sqrt(square) <= goal
        new = _Iteration(step, residual, -residual + beta * old.direction, square, _End(leaves | small, leaves))
        return jax.tree.map(lambda kept, fresh: jnp.where(old.ended.done, kept, fresh), old, new)

    start = _End(norm0 == 0.0, jnp.asarray(False))
    begin = _Iteration(jnp.zeros(dim), gradient, -gradient, gradient @ gradient, start)
    end = jax.lax.fori_loop(0, 2 * dim, advance, begin)
    return end.step, end.ended.on_boundary


def _to_boundary(step: Float[Array, " d"], direction: Float[Array, " d"], radius: Float[Array, ""]) -> Float[Array, ""]:
    """Positive root τ of ‖step + τ direction‖ = radius, written without cancellation."""
    a, b, c = direction @ direction, step @ direction, step @ step - radius**2
    root = jnp.sqrt(jnp.maximum(b * b - a * c, 0.0))
    return jnp.where(b > 0, -c / jnp.where(b > 0, b + root, 1.0), (root - b) / jnp.where(a > 0, a, 1.0))
