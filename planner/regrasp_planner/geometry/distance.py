"""Signed distances, witness points and contact normals of convex bodies, differentiable by their poses.

The signed distance of bodies A and B is max over unit x of x·(p_B − p_A) − h_A(R_Aᵀx) − h_B(−R_Bᵀx): the gap between
the bodies, or minus the least translation that separates them. Its maximiser x* is the contact normal, from A to B.

Accuracy. The DSF contains the hull, so the distance is never larger than that of the hulls (`certified_distance` gives
a bound that does not depend on the sharpness). Separated pairs have one maximiser, which the centre line finds.
Overlapping pairs have several: the best few of a fixed set of directions are climbed as well; every result is still a
lower bound of the distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float

from regrasp_planner.geometry.ascent import core_terms, quadratic, tangent_basis
from regrasp_planner.geometry.pair_solver import Pairs, maximisers
from regrasp_planner.geometry.support import ConvexBody, exact_support_value

Pose7 = Float[Array, "N 7"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Separation:
    """Result of `separation` for N pairs, in the world.

    Attributes:
        distance: (N,) signed distance, metres, negative when overlapping.
        direction: (N, 3) unit contact normal x*, from A to B.
        point_a: (N, 3) point of A's surface with outward normal x*, metres.
        point_b: (N, 3) point of B's surface with outward normal −x*, metres.
    """

    distance: Float[Array, " N"]
    direction: Float[Array, "N 3"]
    point_a: Float[Array, "N 3"]
    point_b: Float[Array, "N 3"]


@partial(jax.jit, static_argnames="thorough")
def separation(
    bodies_a: ConvexBody,
    poses_a: Pose7,
    bodies_b: ConvexBody,
    poses_b: Pose7,
    x0: Float[Array, "N 3"] | None = None,
    thorough: bool = True,
) -> Separation:
    """Signed distances, contact normals and witness points of N pairs of bodies.

    Everything is differentiable by the poses, forwards and backwards: the distance by the envelope theorem, direction
    and points by the implicit function theorem. Derivatives by the shapes are not given (they are zero).

    Args:
        bodies_a, bodies_b: batches of N bodies.
        poses_a, poses_b: (N, 7) wxyz_xyz poses in the world.
        x0: (N, 3) directions to start from (need not be of unit length), for example the last result; default: from
            centre to centre, or the normal of the ellipsoids of inertia if that is better.
        thorough: climb overlapping pairs from six more directions (about six times their cost). Without it one local
            maximum is taken, a smaller distance than the true one for about one overlapping pair in fifteen.
    """
    frozen_a, frozen_b = jax.lax.stop_gradient((bodies_a, bodies_b))
    rotations = jaxlie.SO3(poses_a[:, :4]).as_matrix(), jaxlie.SO3(poses_b[:, :4]).as_matrix()
    shifts = poses_a[:, 4:], poses_b[:, 4:]
    start = jnp.zeros((poses_a.shape[0], 3)) if x0 is None else jax.lax.stop_gradient(x0)
    x, arm_a, arm_b = _contacts(thorough, frozen_a, rotations[0], shifts[0], frozen_b, rotations[1], shifts[1], start)
    # Envelope theorem: with x and the points of the bodies held, only the bodies' motion is left.
    held_x, held_a, held_b = jax.lax.stop_gradient((x, arm_a, arm_b))
    local_a = jnp.einsum("nij,ni->nj", jax.lax.stop_gradient(rotations[0]), held_a)
    local_b = jnp.einsum("nij,ni->nj", jax.lax.stop_gradient(rotations[1]), held_b)
    moved_a = jnp.einsum("nij,nj->ni", rotations[0], local_a) + shifts[0]
    moved_b = jnp.einsum("nij,nj->ni", rotations[1], local_b) + shifts[1]
    return Separation((held_x * (moved_b - moved_a)).sum(-1), x, arm_a + shifts[0], arm_b + shifts[1])


@jax.jit
def signed_distance(body_a: ConvexBody, pose_a: jaxlie.SE3, body_b: ConvexBody, pose_b: jaxlie.SE3) -> Float[Array, ""]:
    """Signed distance of two bodies, metres; see `separation` for many pairs at once, derivatives and accuracy."""
    return _single(body_a, pose_a, body_b, pose_b).distance[0]


@jax.jit
def contact_direction(
    body_a: ConvexBody, pose_a: jaxlie.SE3, body_b: ConvexBody, pose_b: jaxlie.SE3
) -> Float[Array, " 3"]:
    """Contact normal x* (3,) of two bodies in the world, unit, from A to B; differentiable by both poses."""
    return _single(body_a, pose_a, body_b, pose_b).direction[0]


def hull_gap(
    x: Float[Array, "N 3"], bodies_a: ConvexBody, poses_a: Pose7, bodies_b: ConvexBody, poses_b: Pose7
) -> Float[Array, " N"]:
    """Gap (N,) of the swept hulls themselves along unit directions x from A to B, metres.

    Along any direction it is a lower bound of the signed distance. At a contact normal of the DSF the bound is tight to
    second order in the error of the normal.
    """
    support_a = exact_support_value(bodies_a, jaxlie.SO3(poses_a[:, :4]).inverse() @ x)
    support_b = exact_support_value(bodies_b, jaxlie.SO3(poses_b[:, :4]).inverse() @ -x)
    return (x * (poses_b[:, 4:] - poses_a[:, 4:])).sum(-1) - support_a - support_b


@partial(jax.jit, static_argnames="thorough")
def certified_distance(
    bodies_a: ConvexBody,
    poses_a: Pose7,
    bodies_b: ConvexBody,
    poses_b: Pose7,
    x0: Float[Array, "N 3"] | None = None,
    thorough: bool = True,
) -> Float[Array, " N"]:
    """Lower bound (N,) of the signed distance of the swept hulls, metres: `hull_gap` along the contact normal.

    Arguments as in `separation`.
    """
    x = separation(bodies_a, poses_a, bodies_b, poses_b, x0, thorough).direction
    return hull_gap(x, bodies_a, poses_a, bodies_b, poses_b)


def _single(body_a: ConvexBody, pose_a: jaxlie.SE3, body_b: ConvexBody, pose_b: jaxlie.SE3) -> Separation:
    batch_a, batch_b = ConvexBody.stack([body_a]), ConvexBody.stack([body_b])
    return separation(batch_a, pose_a.wxyz_xyz[None], batch_b, pose_b.wxyz_xyz[None])


def _pairs(
    bodies_a: ConvexBody,
    rotations_a: Float[Array, "N 3 3"],
    shifts_a: Float[Array, "N 3"],
    bodies_b: ConvexBody,
    rotations_b: Float[Array, "N 3 3"],
    shifts_b: Float[Array, "N 3"],
) -> Pairs:
    offsets_a = bodies_a.vertices - bodies_a.center[:, None, :]
    offsets_b = bodies_b.center[:, None, :] - bodies_b.vertices
    center_a = jnp.einsum("nij,nj->ni", rotations_a, bodies_a.center) + shifts_a
    center_b = jnp.einsum("nij,nj->ni", rotations_b, bodies_b.center) + shifts_b
    return Pairs(
        _turned(rotations_a, offsets_a),
        _turned(rotations_b, offsets_b),
        (center_b - center_a).T,
        bodies_a.radius + bodies_b.radius,
        jnp.round(bodies_a.sharpness),
        jnp.round(bodies_b.sharpness),
    )


def _turned(rotations: Float[Array, "N 3 3"], offsets: Float[Array, "N V 3"]) -> Float[Array, "3 V N"]:
    turn, w = jnp.moveaxis(rotations, 0, -1), jnp.moveaxis(offsets, 0, -1)
    return jnp.stack([turn[i, 0] * w[:, 0] + turn[i, 1] * w[:, 1] + turn[i, 2] * w[:, 2] for i in range(3)])


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _contacts(
    thorough: bool,
    bodies_a: ConvexBody,
    rotations_a: Float[Array, "N 3 3"],
    shifts_a: Float[Array, "N 3"],
    bodies_b: ConvexBody,
    rotations_b: Float[Array, "N 3 3"],
    shifts_b: Float[Array, "N 3"],
    start: Float[Array, "N 3"],
) -> tuple[Float[Array, "N 3"], Float[Array, "N 3"], Float[Array, "N 3"]]:
    """x* and both support points relative to the origins of the bodies' frames, in world axes."""
    pairs = _pairs(bodies_a, rotations_a, shifts_a, bodies_b, rotations_b, shifts_b)
    x = maximisers(pairs, start.T, thorough)
    _, core_a, _ = core_terms(pairs.offsets_a, x, pairs.sharpness_a)
    _, core_b, _ = core_terms(pairs.offsets_b, x, pairs.sharpness_b)
    direction = x.T
    arm_a = core_a.T + bodies_a.radius[:, None] * direction + _rotate(rotations_a, bodies_a.center)
    arm_b = -core_b.T - bodies_b.radius[:, None] * direction + _rotate(rotations_b, bodies_b.center)
    return direction, arm_a, arm_b


def _rotate(rotations: Float[Array, "N 3 3"], vectors: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
    return jnp.einsum("nij,nj->ni", rotations, vectors)


@_contacts.defjvp
def _contacts_jvp(thorough, primals, tangents):  # pyright: ignore[reportMissingParameterType, reportUnusedFunction]
    """Implicit function theorem on the tangent plane at x*.

    A support point in world axes is s(x) = R σ(Rᵀx), so with the Hessian H = R ∇²h Rᵀ its differential is
    ds = dR Rᵀ s + H (dx + R dRᵀ x). The maximiser satisfies P (Δ − s_A + s_B) = 0 with Δ = p_B − p_A, hence
    (P (H_A + H_B) P + F·I) dx = P (dΔ − ∂s_A + ∂s_B), where ∂ leaves x fixed.
    """
    bodies_a, rotations_a, shifts_a, bodies_b, rotations_b, shifts_b, _ = primals
    _, turn_a, move_a, _, turn_b, move_b, _ = tangents
    x, arm_a, arm_b = _contacts(thorough, *primals)
    pairs = _pairs(bodies_a, rotations_a, shifts_a, bodies_b, rotations_b, shifts_b)
    _, _, hessian_a = core_terms(pairs.offsets_a, x.T, pairs.sharpness_a)
    _, _, hessian_b = core_terms(pairs.offsets_b, x.T, pairs.sharpness_b)
    value = (x * (shifts_b + arm_b - shifts_a - arm_a)).sum(-1)
    hess_a = _full(hessian_a) + _sweep_hessian(bodies_a.radius, x)
    hess_b = _full(hessian_b) + _sweep_hessian(bodies_b.radius, x)

    slip_a = jnp.einsum("nij,nkj,nk->ni", rotations_a, turn_a, x)
    slip_b = jnp.einsum("nij,nkj,nk->ni", rotations_b, turn_b, x)
    part_a = jnp.einsum("nij,nkj,nk->ni", turn_a, rotations_a, arm_a) + _rotate(hess_a, slip_a)
    part_b = jnp.einsum("nij,nkj,nk->ni", turn_b, rotations_b, arm_b) - _rotate(hess_b, slip_b)
    residual = (move_b - move_a - part_a + part_b).T

    u, v = tangent_basis(x.T)
    total = hessian_a + hessian_b
    bend = value + bodies_a.radius + bodies_b.radius
    huu, huv, hvv = quadratic(total, u, u) + bend, quadratic(total, u, v), quadratic(total, v, v) + bend
    ru, rv = (residual * u).sum(0), (residual * v).sum(0)
    determinant = huu * hvv - huv * huv
    du, dv = (hvv * ru - huv * rv) / determinant, (huu * rv - huv * ru) / determinant
    dx = (du * u + dv * v).T
    return (x, arm_a, arm_b), (dx, part_a + _rotate(hess_a, dx), part_b - _rotate(hess_b, dx))


def _full(h: Float[Array, "6 N"]) -> Float[Array, "N 3 3"]:
    rows = jnp.stack([h[0], h[3], h[4], h[3], h[1], h[5], h[4], h[5], h[2]], axis=-1)
    return rows.reshape(-1, 3, 3)


def _sweep_hessian(radius: Float[Array, " N"], x: Float[Array, "N 3"]) -> Float[Array, "N 3 3"]:
    return radius[:, None, None] * (jnp.eye(3) - x[:, :, None] * x[:, None, :])
