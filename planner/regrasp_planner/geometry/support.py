"""Convex bodies as differentiable support functions (DSF).

A body is the hull of its vertices, swept by a sphere of its radius r. With an interior point c, w_i = v_i − c,
z_i = max(w_i·x, 0), m = max z, ρ = z/m and S = Σ ρᵖ, its DSF at sharpness p and the derivatives are

    h(x)  = c·x + m S^{1/p} + r‖x‖
    ∇h(x) = s(x) = c + S^{1/p−1} Σ ρ^{p−1} w_i + r x/‖x‖
    ∇²h   = (p−1) [ S^{1/p−1}/m Σ ρ^{p−2} w_i w_iᵀ − (s₀−c)(s₀−c)ᵀ / (m S^{1/p}) ] + r (I − x̂x̂ᵀ)/‖x‖

with s₀ the support point without the sweep (J. Lee, M. Lee, D. Lee, "Uncertain pose estimation during contact tasks
using differentiable contact features", RSS 2023). h is convex, of degree 1, C² for p > 2, and never below the exact
support function: S ≥ 1. Distances taken from it are therefore conservative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from regrasp_planner.batching import bucket_size
from regrasp_planner.errors import GeometryError
from regrasp_planner.geometry.hull import checked_points, reduced_hull, solid_center
from regrasp_planner.memo import IdentityMemo

DEFAULT_SHARPNESS = 512
"""Sharpness at which a body of 5 cm is within about 0.1 mm of its hull."""

EXPONENT_BITS = 11
"""Sharpness is a whole number below 2**11: powers are then a few multiplications, several times cheaper than pow."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ConvexBody:
    """A convex body, or a batch of them: the hull of ``vertices`` swept by a sphere.

    Attributes:
        vertices: (*batch, V, 3) metres, padded to a bucket size by repeating ``center``, which adds nothing to h.
        center: (*batch, 3) a point strictly inside the hull, metres.
        radius: (*batch,) radius of the sweeping sphere, metres; 0 for a polyhedron.
        sharpness: (*batch,) p, a whole number in 3…2047; it is data, so changing it never compiles anew.
    """

    vertices: Float[Array, "*batch V 3"]
    center: Float[Array, "*batch 3"]
    radius: Float[Array, "*batch"]
    sharpness: Float[Array, "*batch"]

    @classmethod
    def from_vertices(
        cls,
        vertices: Float[np.ndarray, "N 3"],
        radius: float = 0.0,
        sharpness: float = DEFAULT_SHARPNESS,
        max_vertices: int = 64,
    ) -> ConvexBody:
        """Body from any points that span a volume; their convex hull is taken.

        A hull of more than ``max_vertices`` vertices is thinned out greedily, and the sweep radius grows by the largest
        distance of a left-out vertex from what remains: the result always contains the hull.

        Args:
            vertices: (N, 3) points, metres.
            radius: sweep, metres.
            sharpness: p.
            max_vertices: most vertices to keep, at least 4.

        Raises:
            GeometryError: wrong shape, not finite, fewer than 4 points, no volume, negative radius, or bad sharpness.
        """
        points = checked_points(vertices)
        if not np.isfinite(radius) or radius < 0:
            raise GeometryError(f"radius is {radius}; give a finite sweep radius of at least 0 m")
        kept, slack = reduced_hull(points, max_vertices)
        center = solid_center(kept)
        padded = np.tile(center, (bucket_size(len(kept)), 1))
        padded[: len(kept)] = kept
        # NumPy on the host: bodies are put together many times before they reach a compiled function.
        leaves: Any = padded, center, np.asarray(float(radius) + slack), np.asarray(_checked_sharpness(sharpness))
        return cls(*leaves)

    @classmethod
    def box(
        cls,
        size: Sequence[float] | Float[np.ndarray, " 3"],
        pose: jaxlie.SE3 | None = None,
        sharpness: float = DEFAULT_SHARPNESS,
    ) -> ConvexBody:
        """Box of full edge lengths ``size`` (3,), metres, centred on ``pose`` (default: the origin).

        Raises:
            GeometryError: ``size`` is not three positive finite lengths.
        """
        edges = np.asarray(size, float)
        if edges.shape != (3,) or not np.isfinite(edges).all() or (edges <= 0).any():
            raise GeometryError(f"box size is {size}; give three positive full edge lengths in metres")
        signs = np.array([[i, j, k] for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (-0.5, 0.5)])
        return cls.from_vertices(_placed(signs * edges, pose), sharpness=sharpness)

    @classmethod
    def capsule(
        cls, radius: float, length: float, pose: jaxlie.SE3 | None = None, sharpness: float = DEFAULT_SHARPNESS
    ) -> ConvexBody:
        """Capsule along z: the segment of ``length`` metres centred on ``pose``, swept by ``radius`` metres.

        The core is not the bare segment, whose support function has a kink, but a spindle with a waist of 4 % of the
        radius (at most 1 mm); the body contains the capsule and exceeds it by at most that much.

        Raises:
            GeometryError: a length or radius that is not positive and finite.
        """
        if not (np.isfinite(radius) and radius > 0):
            raise GeometryError(f"capsule radius is {radius}; give a positive length in metres")
        if not (np.isfinite(length) and length >= 0):
            raise GeometryError(f"capsule length is {length}; give the length of its cylinder, at least 0 m")
        waist = min(0.04 * radius, 1e-3)
        core = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
        core *= [waist, waist, max(0.5 * length, waist)]
        return cls.from_vertices(_placed(core, pose), radius=radius, sharpness=sharpness)

    @classmethod
    def sphere(
        cls, radius: float, center: Sequence[float] = (0.0, 0.0, 0.0), sharpness: float = DEFAULT_SHARPNESS
    ) -> ConvexBody:
        """Sphere of ``radius`` metres about ``center`` (3,); the body contains it and exceeds it by at most 1 mm."""
        at = jaxlie.SE3.from_translation(jnp.asarray(center, float))
        return cls.capsule(radius, 0.0, at, sharpness)

    @property
    def batch_size(self) -> int:
        """Length of the leading batch axis."""
        if self.vertices.ndim < 3:
            raise GeometryError("this is a single body, not a batch; stack it with ConvexBody.stack([body])")
        return self.vertices.shape[0]

    def __getitem__(self, index: int | slice | np.ndarray | Array) -> ConvexBody:
        return jax.tree.map(lambda leaf: leaf[index], self)

    def with_sharpness(self, sharpness: float | Float[Array, ""]) -> ConvexBody:
        """The same body at another sharpness p (a number, or a traced scalar; whole numbers in 3…2047)."""
        if isinstance(sharpness, int | float):
            sharpness = _checked_sharpness(sharpness)
            return replace(self, sharpness=np.full(np.shape(self.radius), sharpness))
        return replace(self, sharpness=jnp.broadcast_to(jnp.asarray(sharpness, float), self.radius.shape))

    def transformed(self, pose: jaxlie.SE3) -> ConvexBody:
        """The body moved by ``pose`` (batch axes of both must be equal, or the pose single)."""
        rotation = pose.rotation().as_matrix()
        shift = pose.translation()
        return replace(
            self,
            vertices=jnp.einsum("...ij,...vj->...vi", rotation, self.vertices) + shift[..., None, :],
            center=jnp.einsum("...ij,...j->...i", rotation, self.center) + shift,
        )

    def thinned(self, max_vertices: int) -> ConvexBody:
        """A single body that contains this one, in an array of at most ``max_vertices`` vertices.

        Made once for each body: it is asked for in every scene the body stands in.
        """
        if self.vertices.shape[-2] <= max_vertices:
            return self

        def thin() -> ConvexBody:
            points = self.hull_vertices()
            body = self
            if len(points) > max_vertices:
                body = ConvexBody.from_vertices(points, float(self.radius), float(self.sharpness), max_vertices)
            # The rest is padding.
            return replace(body, vertices=body.vertices[:max_vertices])

        return _THINNED.get(self, thin, max_vertices)

    def hull_vertices(self) -> Float[np.ndarray, "N 3"]:
        """Vertices of a single body without the padding, (N, 3) metres, on the host; the sweep is not included."""
        if self.vertices.ndim != 2:
            raise GeometryError("hull_vertices needs a single body; take one out of the batch with body[i]")
        vertices = np.asarray(self.vertices)
        return vertices[(vertices != np.asarray(self.center)).any(axis=1)]

    def bounding_sphere(self) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch"]]:
        """Centre and radius, metres, of a sphere that contains the body (the hull with its sweep)."""
        reach = jnp.linalg.norm(self.vertices - self.center[..., None, :], axis=-1).max(-1)
        return self.center, reach + self.radius

    def padded_to(self, batch: int | None = None, vertices: int | None = None) -> ConvexBody:
        """Padded to ``vertices`` vertices (nothing changes) and to ``batch`` bodies (the last one repeated).

        Raises:
            GeometryError: the body already has more.
        """
        body = self
        if vertices is not None:
            extra = vertices - body.vertices.shape[-2]
            if extra < 0:
                raise GeometryError(f"body has {body.vertices.shape[-2]} vertices, more than the {vertices} to pad to")
            if extra:
                xp = _library([body])
                fill = xp.repeat(body.center[..., None, :], extra, axis=-2)
                body = replace(body, vertices=xp.concatenate([body.vertices, fill], axis=-2))
        if batch is not None:
            extra = batch - body.batch_size
            if extra < 0:
                raise GeometryError(f"batch holds {body.batch_size} bodies, more than the {batch} to pad to")
            if extra:
                xp = _library([body])
                body = jax.tree.map(lambda leaf: xp.concatenate([leaf, xp.repeat(leaf[-1:], extra, axis=0)]), body)
        return body

    @staticmethod
    def stack(bodies: Sequence[ConvexBody]) -> ConvexBody:
        """Batch of single bodies, all padded to the largest number of vertices.

        Raises:
            GeometryError: the sequence is empty.
        """
        return ConvexBody.concatenate([jax.tree.map(lambda leaf: leaf[None], body) for body in bodies])

    @staticmethod
    def concatenate(batches: Sequence[ConvexBody]) -> ConvexBody:
        """One batch out of several, all padded to the largest number of vertices.

        Raises:
            GeometryError: the sequence is empty.
        """
        if not batches:
            raise GeometryError("no bodies to put together; give at least one")
        widest = max(batch.vertices.shape[-2] for batch in batches)
        padded = [batch.padded_to(vertices=widest) for batch in batches]
        xp = _library(padded)
        return jax.tree.map(lambda *leaves: xp.concatenate(leaves), *padded)


_THINNED = IdentityMemo()


def _library(bodies: Sequence[ConvexBody]) -> Any:
    """NumPy for bodies on the host, so that putting them together compiles nothing; JAX under a transformation."""
    traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(list(bodies)))
    return jnp if traced else np


def support_value(body: ConvexBody, x: Float[Array, "*batch 3"]) -> Float[Array, "*batch"]:
    """h(x), metres for a unit direction x (3,); batch axes of body and x broadcast."""
    _, heights, top = _heights(body, x)
    ratio = heights / top[..., None]
    power = whole_power(ratio, _exponent(body)[..., None] - 2) * ratio**2
    rounded = power.sum(-1) ** (1 / _exponent(body))
    return (body.center * x).sum(-1) + top * rounded + body.radius * jnp.linalg.norm(x, axis=-1)


def support_point(body: ConvexBody, x: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """s(x) = ∇h(x), the point of the body's surface with outward normal x, metres."""
    core, _, _ = _core_terms(body, x)
    norm = jnp.linalg.norm(x, axis=-1, keepdims=True)
    return body.center + core + body.radius[..., None] * x / norm


def support_hessian(body: ConvexBody, x: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """∇²h(x), metres for a unit direction; positive semidefinite with x in its null space."""
    core, second, value = _core_terms(body, x)
    p = _exponent(body)[..., None, None]
    core_outer = core[..., :, None] * core[..., None, :] / value[..., None, None]
    norm = jnp.linalg.norm(x, axis=-1)[..., None, None]
    sweep = (jnp.eye(3) - x[..., :, None] * x[..., None, :] / norm**2) / norm
    return (p - 1) * (second - core_outer) + body.radius[..., None, None] * sweep


def exact_support_value(body: ConvexBody, x: Float[Array, "*batch 3"]) -> Float[Array, "*batch"]:
    """Support function of the swept hull itself, max_i v_i·x + r‖x‖ (the limit p → ∞), metres for a unit x."""
    return jnp.einsum("...vi,...i->...v", body.vertices, x).max(-1) + body.radius * jnp.linalg.norm(x, axis=-1)


@jax.jit
def whole_power(base: Float[Array, "*n"], exponent: Float[Array, "*m"]) -> Float[Array, "*n"]:
    """``base ** exponent`` (broadcast) for whole, traced exponents in 0…2047, by repeated squaring."""
    bits = exponent.astype(jnp.int32)
    result = jnp.ones_like(base)
    for bit in range(EXPONENT_BITS):
        result = jnp.where((bits >> bit) & 1 == 1, result * base, result)
        base = base * base
    return result


def _exponent(body: ConvexBody) -> Float[Array, "*batch"]:
    return jnp.clip(jnp.round(body.sharpness), 3, 2**EXPONENT_BITS - 1)


def _heights(
    body: ConvexBody, x: Float[Array, "*batch 3"]
) -> tuple[Float[Array, "*batch V 3"], Float[Array, "*batch V"], Float[Array, "*batch"]]:
    offsets = body.vertices - body.center[..., None, :]
    heights = jnp.maximum(jnp.einsum("...vi,...i->...v", offsets, x), 0.0)
    return offsets, heights, heights.max(-1)


def _core_terms(
    body: ConvexBody, x: Float[Array, "*batch 3"]
) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3 3"], Float[Array, "*batch"]]:
    """s₀ − c, S^{1/p−1}/m Σ ρ^{p−2} w wᵀ, and m S^{1/p}."""
    offsets, heights, top = _heights(body, x)
    p = _exponent(body)
    ratio = heights / top[..., None]
    weight = whole_power(ratio, p[..., None] - 2)
    total = (weight * ratio**2).sum(-1)
    scale = total ** (1 / p - 1)
    core = scale[..., None] * jnp.einsum("...v,...vi->...i", weight * ratio, offsets)
    second = (scale / top)[..., None, None] * jnp.einsum("...v,...vi,...vj->...ij", weight, offsets, offsets)
    return core, second, top * total ** (1 / p)


def _checked_sharpness(sharpness: float) -> float:
    if not (3 <= sharpness < 2**EXPONENT_BITS and float(sharpness).is_integer()):
        raise GeometryError(f"sharpness is {sharpness}; give a whole number from 3 to {2**EXPONENT_BITS - 1}")
    return float(sharpness)


def _placed(points: Float[np.ndarray, "N 3"], pose: jaxlie.SE3 | None) -> Float[np.ndarray, "N 3"]:
    return points if pose is None else np.asarray(pose.apply(jnp.asarray(points)))
