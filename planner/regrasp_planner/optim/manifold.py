"""Products of SE(3) and Rⁿ, with tangent vectors written in orthonormal coordinates.

A tangent vector is a plain array with one number per dimension of the manifold, so that Hessians are small square
matrices and any JAX function of a point can be differentiated: the Riemannian gradient at x is the ordinary gradient
of ξ ↦ f(retract(x, ξ)) at ξ = 0 (Absil, Mahony, Sepulchre, *Optimization Algorithms on Matrix Manifolds*, §3.6, 4.1;
for second derivatives at points where the gradient does not vanish the retractions used are of second order).
All of these manifolds are Lie groups with left-invariant metrics: left translation takes one tangent space to another,
and in these coordinates it is the identity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float

Point = Any
"""A point: an array for the simple manifolds, a tuple of points for a `Product`."""


class Manifold(Protocol):
    """What the solvers need of a manifold."""

    @property
    def dim(self) -> int:
        """Dimension d, the length of a tangent vector."""
        ...

    def retract(self, point: Point, tangent: Float[Array, " d"]) -> Point:
        """Point reached from ``point`` along ``tangent``; of second order at zero."""
        ...


@dataclass(frozen=True)
class Euclidean:
    """Rⁿ. Points and tangent vectors are (dim,)."""

    dim: int

    def retract(self, point: Float[Array, " n"], tangent: Float[Array, " n"]) -> Float[Array, " n"]:
        """Sum of point and tangent."""
        return point + tangent


@dataclass(frozen=True)
class SE3:
    """Rigid motions. Points are (7,) wxyz_xyz, tangents (6,) = (v, ω) of the body twist (left-trivialised).

    Attributes:
        length: metres of translation that count as much as one radian in the (left-invariant) metric.
    """

    length: float = 1.0

    @property
    def dim(self) -> int:
        """Six: three of translation, three of rotation."""
        return 6

    def retract(self, point: Float[Array, " 7"], tangent: Float[Array, " 6"]) -> Float[Array, " 7"]:
        """Product g·exp(ξ), the quaternion kept at unit length."""
        v, omega = self.length * tangent[:3], tangent[3:]
        square = omega @ omega
        near_zero = square < 1e-4
        # Series near zero, to an order that leaves first and second derivatives exact there (jaxlie's exp, as of
        # 1.5, is exact only to first order in the translation).
        safe = jnp.where(near_zero, 1.0, square)
        angle = jnp.sqrt(safe)
        half_cosine = jnp.where(near_zero, 1.0 - square / 8.0 + square**2 / 384.0, jnp.cos(0.5 * angle))
        half_sinc = jnp.where(near_zero, 0.5 - square / 48.0 + square**2 / 3840.0, jnp.sin(0.5 * angle) / angle)
        first = jnp.where(near_zero, 0.5 - square / 24.0 + square**2 / 720.0, (1.0 - jnp.cos(angle)) / safe)
        second = jnp.where(
            near_zero, 1.0 / 6.0 - square / 120.0 + square**2 / 5040.0, (angle - jnp.sin(angle)) / (safe * angle)
        )
        across = jnp.cross(omega, v)
        turn = jaxlie.SO3(jnp.concatenate([half_cosine[None], half_sinc * omega]))
        rotation = jaxlie.SO3(point[:4])
        quaternion = (rotation @ turn).wxyz
        shift = rotation @ (v + first * across + second * jnp.cross(omega, across))
        return jnp.concatenate([quaternion / jnp.linalg.norm(quaternion), point[4:] + shift])


@dataclass(frozen=True)
class Product:
    """Product of manifolds. Points are tuples of the factors' points; tangents are concatenated."""

    factors: tuple[Manifold, ...]

    @property
    def dim(self) -> int:
        """Sum of the factors' dimensions."""
        return sum(factor.dim for factor in self.factors)

    def retract(self, point: Point, tangent: Float[Array, " d"]) -> Point:
        """Factor by factor."""
        moved: list[Point] = []
        start = 0
        for factor, part in zip(self.factors, point, strict=True):
            moved.append(factor.retract(part, tangent[start : start + factor.dim]))
            start += factor.dim
        return tuple(moved)
