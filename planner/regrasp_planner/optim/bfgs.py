"""BFGS model of a Hessian in tangent coordinates, damped so that it stays positive definite."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


def bfgs_update(
    hessian: Float[Array, "d d"],
    step: Float[Array, " d"],
    change: Float[Array, " d"],
    *,
    first: Bool[Array, ""] | bool = False,
    damping: float = 0.2,
) -> Float[Array, "d d"]:
    """Hessian model after the gradient was seen to change by ``change`` along ``step``.

    Powell's damping (Nocedal & Wright, *Numerical Optimization*, procedure 18.2) mixes ``change`` with B·step where
    the curvature seen is below ``damping`` times the model's, so B stays positive definite wherever the function is
    not convex. All three live in one tangent space: the caller transports the far gradient back, and the updated
    matrix forward (Huang, Gallivan, Absil, *A Broyden class of quasi-Newton methods for Riemannian optimization*,
    2015).

    Args:
        hessian: (d, d) symmetric positive definite model B.
        step: (d,) step s, in the tangent space of B.
        change: (d,) change of gradient y, transported to that space.
        first: where true, B is first replaced by (y·y / s·y) I, the scale that was seen.
        damping: smallest ratio s·y / s·B·s taken as it is.

    Returns:
        (d, d) updated model; ``hessian`` itself if the step is zero or anything is not finite.
    """
    curvature = step @ change
    square = step @ step
    scale = jnp.where(curvature > 1e-12 * square, (change @ change) / jnp.where(curvature > 0, curvature, 1.0), 1.0)
    eye = jnp.eye(hessian.shape[0])
    base = jnp.where(first & (curvature > 1e-12 * square), jnp.clip(scale, 1e-8, 1e12) * eye, hessian)
    image = base @ step
    modelled = step @ image
    gap = modelled - curvature
    weight = jnp.where(curvature < damping * modelled, (1.0 - damping) * modelled / jnp.where(gap > 0, gap, 1.0), 1.0)
    mixed = weight * change + (1.0 - weight) * image
    seen = step @ mixed
    usable = (square > 0) & (modelled > 0) & (seen > 0)
    updated = (
        base
        - jnp.outer(image, image) / jnp.where(usable, modelled, 1.0)
        + jnp.outer(mixed, mixed) / jnp.where(usable, seen, 1.0)
    )
    usable = usable & jnp.isfinite(updated).all()
    return jnp.where(usable, 0.5 * (updated + updated.T), hessian)
