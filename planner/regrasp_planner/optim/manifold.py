"""Products of S², SE(3) and Rⁿ, each with tangent vectors written in orthonormal coordinates.

A tangent vector is a plain array of as many numbers as the manifold has dimensions, so that Hessians are small square
matrices and any JAX function of a point can be differentiated: the Riemannian gradient at x is the ordinary gradient
of ξ ↦ f(retract(x, ξ)) at ξ = 0 (Absil, Mahony, Sepulchre, *Optimization Algorithms on Matrix Manifolds*, §3.6, 4.1;
for second derivatives at points where the gradient does not vanish the retractions used are of second order).
Moving from one tangent space to another is a change of coordinates, a square orthogonal matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import jax
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

    def transport(self, point: Point, tangent: Float[Array, " d"], to: Point) -> Float[Array, "d d"]:
        """Orthogonal matrix taking tangent coordinates at ``point`` to those at ``to = retract(point, tangent)``."""
        ...

    def random_point(self, key: Array) -> Point:
        """A random point: uniform on compact parts, standard normal on the others."""
        ...


@dataclass(frozen=True)
class Euclidean:
    """Rⁿ. Points and tangent vectors are (n,)."""

    n: int

    @property
    def dim(self) -> int:
        """N."""
        return self.n

    def retract(self, point: Float[Array, " n"], tangent: Float[Array, " n"]) -> Float[Array, " n"]:
        """Sum of point and tangent."""
        return point + tangent

    def transport(self, point: Point, tangent: Float[Array, " n"], to: Point) -> Float[Array, "n n"]:
        """Identity."""
        return jnp.eye(self.n)

    def random_point(self, key: Array) -> Float[Array, " n"]:
        """Standard normal."""
        return jax.random.normal(key, (self.n,))


def tangent_basis(x: Float[Array, " 3"]) -> Float[Array, "3 2"]:
    """Orthonormal basis of the plane normal to the unit vector x.

    Duff et al., *Building an Orthonormal Basis, Revisited* (JCGT 2017): free of branches, smooth away from z = 0.
    """
    sign = jnp.where(x[2] >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + x[2])
    b = x[0] * x[1] * a
    first = jnp.stack([1.0 + sign * x[0] ** 2 * a, sign * b, -sign * x[0]])
    second = jnp.stack([b, sign + x[1] ** 2 * a, -x[1]])
    return jnp.stack([first, second], axis=1)


@dataclass(frozen=True)
class Sphere:
    """Unit sphere S² in R³. Points are unit vectors (3,), tangents (2,) in `tangent_basis`. Exponential map."""

    @property
    def dim(self) -> int:
        """2."""
        return 2

    def retract(self, point: Float[Array, " 3"], tangent: Float[Array, " 2"]) -> Float[Array, " 3"]:
        """Exponential map: cos‖v‖ x + sinc‖v‖ v."""
        v = tangent_basis(point) @ tangent
        square = v @ v
        near_zero = square < 1e-8
        # sqrt has no derivative at 0, so the series is used there, to an order that makes second derivatives exact.
        norm = jnp.sqrt(jnp.where(near_zero, 1.0, square))
        cosine = jnp.where(near_zero, 1.0 - square / 2.0 + square**2 / 24.0, jnp.cos(norm))
        sinc = jnp.where(near_zero, 1.0 - square / 6.0 + square**2 / 120.0, jnp.sin(norm) / norm)
        moved = cosine * point + sinc * v
        return moved / jnp.linalg.norm(moved)

    def transport(
        self, point: Float[Array, " 3"], tangent: Float[Array, " 2"], to: Float[Array, " 3"]
    ) -> Float[Array, "2 2"]:
        """Parallel transport along the great circle, by the rotation that takes ``point`` to ``to``."""
        axis = jnp.cross(point, to)
        basis = tangent_basis(point)
        # R = I + [a]× + [a]×² / (1 + x·y); steps are kept below half a turn by the trust region.
        turned = basis + jnp.cross(axis, basis, axisb=0, axisc=0)
        twice = jnp.cross(axis, jnp.cross(axis, basis, axisb=0, axisc=0), axisb=0, axisc=0)
        turned = turned + twice / jnp.maximum(1.0 + point @ to, 1e-9)
        return tangent_basis(to).T @ turned

    def random_point(self, key: Array) -> Float[Array, " 3"]:
        """Uniform on the sphere."""
        x = jax.random.normal(key, (3,))
        return x / jnp.linalg.norm(x)


@dataclass(frozen=True)
class SE3:
    """Rigid motions. Points are (7,) wxyz_xyz, tangents (6,) = (v, ω) of the body twist (left-trivialised).

    Attributes:
        length: metres of translation that count as much as one radian in the (left-invariant) metric.
    """

    length: float = 1.0

    @property
    def dim(self) -> int:
        """6."""
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

    def transport(self, point: Point, tangent: Float[Array, " 6"], to: Point) -> Float[Array, "6 6"]:
        """Left translation, the identity in these coordinates."""
        return jnp.eye(6)

    def random_point(self, key: Array) -> Float[Array, " 7"]:
        """Uniform rotation, standard normal translation times ``length``."""
        turn, shift = jax.random.split(key)
        quaternion = jax.random.normal(turn, (4,))
        position = self.length * jax.random.normal(shift, (3,))
        return jnp.concatenate([quaternion / jnp.linalg.norm(quaternion), position])


@dataclass(frozen=True)
class Product:
    """Product of manifolds. Points are tuples of the factors' points; tangents are concatenated."""

    factors: tuple[Manifold, ...]

    def __init__(self, factors: Sequence[Manifold]):
        object.__setattr__(self, "factors", tuple(factors))

    @property
    def dim(self) -> int:
        """Sum of the factors' dimensions."""
        return sum(factor.dim for factor in self.factors)

    def _split(self, tangent: Float[Array, " d"]) -> list[Float[Array, " _"]]:
        parts: list[Float[Array, " _"]] = []
        start = 0
        for factor in self.factors:
            parts.append(tangent[start : start + factor.dim])
            start += factor.dim
        return parts

    def retract(self, point: Point, tangent: Float[Array, " d"]) -> Point:
        """Factor by factor."""
        parts = self._split(tangent)
        return tuple(m.retract(x, v) for m, x, v in zip(self.factors, point, parts, strict=True))

    def transport(self, point: Point, tangent: Float[Array, " d"], to: Point) -> Float[Array, "d d"]:
        """Block diagonal of the factors' matrices."""
        parts = self._split(tangent)
        blocks = [m.transport(x, v, y) for m, x, v, y in zip(self.factors, point, parts, to, strict=True)]
        return jax.scipy.linalg.block_diag(*blocks)

    def random_point(self, key: Array) -> Point:
        """Factor by factor."""
        keys = jax.random.split(key, len(self.factors))
        return tuple(m.random_point(k) for m, k in zip(self.factors, keys, strict=True))
