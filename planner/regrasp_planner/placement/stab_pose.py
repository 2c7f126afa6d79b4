"""StabPose: the poses in which a released object comes to rest on a horizontal plane.

With x the direction, in the object's frame, that points down, the height of the centre of mass above the plane is the
support function h(x) about the centre of mass. The object settles into local minima of h on the sphere (eq. (6), and
Proposition 1 for the way there). h is smoothed to a DSF, minimised from many starts by Riemannian Newton steps within a
trust region at rising sharpness, and tested by the Riemannian Hessian Pᵀ∇²hP − h·I (eq. (7), Algorithm 2).

A DSF at finite sharpness moves, and at low sharpness loses, minima. So a start is followed down only until it is clear
on which facet of the exact hull the object falls, the one that the ray along it from the centre of mass pierces, and
referred to the facet where toppling from there ends: the direction becomes the facet's normal, and the pose counts only
if the foot of the centre of mass lies inside of the facet. Every such facet gets a start of its own beside the uniform
ones, so that rare poses are not lost; one that no uniform start reaches has probability 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from regrasp_planner.batching import bucket_size
from regrasp_planner.errors import GeometryError
from regrasp_planner.geometry.ascent import Model, climb, core_terms, quadratic, tangent_basis
from regrasp_planner.geometry.hull import Facets, facets, qhull
from regrasp_planner.geometry.hull import center_of_mass as solid_center_of_mass

SHARPNESS = 1026
"""Lower ones lose poses with a low rim. There are no stages below it: they would lead across rims that they lose."""

LONGEST_STEP = 0.05
"""Radians: short enough that a start keeps to the way of steepest descent and does not leap over a rim."""

EVALUATIONS = 10
"""Enough for the facets' own starts to converge, and for 98 % of the others to fall where steepest descent takes them.
More would make no more of them agree: what the DSF rounds off, it rounds off near the end of the way."""

TOLERANCE = 0.1
PATIENCE = 4
LEAST_EXTRA = 32


@dataclass(frozen=True)
class StablePoses:
    """Stable poses, most stable first.

    Attributes:
        directions: (m, 3) unit vectors x* in the object's frame that point down in the pose: normals of hull facets.
        rotations: (m, 3, 3) object to world, with third row −x* (eq. (5)).
        stability: (m,) least eigenvalue of the Riemannian Hessian of h at the minimiser (eq. (7)), metres per rad², at
            sharpness `SHARPNESS`; 0 where the rim is so low that the DSF has no minimum. The poses are ranked by it.
        probability: (m,) share of the uniform starts that settle into the pose.
        margin: (m,) distance of the centre of mass's foot from the rim of the support polygon, metres.
        barrier: (m,) how far the centre of mass must rise for the object to roll into another pose, metres.
        height: (m,) height of the centre of mass above the plane, metres.
        starts: (k, 3) the uniform start directions.
        basin: (k,) index of the pose that each start settles into.
        corners: (V, 3) vertices of the hull, seen from the centre of mass, metres.
        ridges: (r, 2, 3) ends of the hull's edges, seen from the centre of mass, that part what settles into one pose
            from what settles into another, metres.
        ridge_poses: (r, 2) index of the pose on either side of each ridge, −1 for one that was left out.
    """

    directions: Float[np.ndarray, "m 3"]
    rotations: Float[np.ndarray, "m 3 3"]
    stability: Float[np.ndarray, " m"]
    probability: Float[np.ndarray, " m"]
    margin: Float[np.ndarray, " m"]
    barrier: Float[np.ndarray, " m"]
    height: Float[np.ndarray, " m"]
    starts: Float[np.ndarray, "k 3"]
    basin: Int[np.ndarray, " k"]
    corners: Float[np.ndarray, "V 3"]
    ridges: Float[np.ndarray, "r 2 3"]
    ridge_poses: Int[np.ndarray, "r 2"]

    def __len__(self) -> int:
        return len(self.directions)


def stable_poses(
    vertices: Float[np.ndarray, "N 3"],
    center_of_mass: Float[np.ndarray, " 3"] | None = None,
    starts: int = 128,
    min_margin: float = 0.0,
) -> StablePoses:
    """Stable poses of the convex hull of ``vertices`` on a horizontal plane (Algorithm 2).

    Args:
        vertices: (N, 3) points of the object, metres; the object may be non-convex, it stands on its hull.
        center_of_mass: (3,) metres; default: of the uniform solid hull.
        starts: number of uniformly spread start directions.
        min_margin: leave out poses whose support margin is not greater than this, metres.

    Raises:
        GeometryError: the vertices are no solid, the centre of mass is not inside of their hull, or ``starts`` < 1.
    """
    if starts < 1:
        raise GeometryError(f"starts is {starts}; give at least 1 start direction")
    hull = qhull(vertices)
    center = solid_center_of_mass(hull) if center_of_mass is None else np.asarray(center_of_mass, float)
    if center.shape != (3,) or not np.isfinite(center).all():
        raise GeometryError(f"centre of mass is {center_of_mass}; give three finite coordinates in metres")
    depth = -(hull.equations[:, :3] @ center + hull.equations[:, 3]).max()
    offsets = hull.points[hull.vertices] - center
    size = float(np.sqrt((offsets**2).sum(axis=1).max()))
    if depth <= 1e-6 * size:
        raise GeometryError(
            f"centre of mass {center} is {-depth:.3g} m outside of the hull of the vertices; give it in their frame"
        )
    faces = facets(hull, center)
    resting = np.flatnonzero(faces.margins > max(min_margin, 1e-9 * size))
    sinks = _sinks(faces.topples_to)

    uniform = fibonacci_sphere(starts)
    begin = np.tile(uniform[0], (starts + bucket_size(max(len(resting), LEAST_EXTRA)), 1))
    begin[:starts] = uniform
    begin[starts : starts + len(resting)] = faces.normals[resting]
    padded = np.zeros((bucket_size(len(offsets)), 3))
    padded[: len(offsets)] = offsets
    ends, curvature = (np.asarray(out) for out in settle(padded.T, begin.T))

    along = ends.T @ faces.normals.T
    facet = along.argmax(axis=1)
    facet[:starts] = (along[:starts] / faces.heights).argmax(axis=1)
    facet = sinks[facet]
    return _ranked(faces, resting, sinks, facet, curvature, uniform, offsets)


@jax.jit
def settle(offsets: Float[Array, "3 V"], starts: Float[Array, "3 N"]) -> tuple[Float[Array, "3 N"], Float[Array, " N"]]:
    """Local minimisers (3, N) of the DSF h of the vertices ``offsets`` (3, V) about the centre of mass.

    Returns:
        The unit minimisers, and the least eigenvalue (N,) of the Riemannian Hessian of h at each, m/rad².
    """
    corners = offsets[:, :, None]
    last = jnp.full(starts.shape[1], float(SHARPNESS))

    def model_at(x: Float[Array, "3 N"], _: Float[Array, " N"]) -> Model:
        value, gradient, hessian = core_terms(corners, x, SHARPNESS)
        u, v = tangent_basis(x)
        return Model(
            -value,
            -(gradient * u).sum(0),
            -(gradient * v).sum(0),
            quadratic(hessian, u, u) - value,
            quadratic(hessian, u, v),
            quadratic(hessian, v, v) - value,
        )

    size = jnp.broadcast_to(jnp.sqrt((offsets**2).sum(0).max()), last.shape)
    ascent = climb(
        model_at,
        size,
        last,
        starts,
        last,
        jnp.ones_like(last, bool),
        patience=PATIENCE,
        widest=LONGEST_STEP,
        tolerance=TOLERANCE,
        evaluations=EVALUATIONS,
    )
    model = ascent.model
    half = 0.5 * (model.huu - model.hvv)
    return ascent.x, 0.5 * (model.huu + model.hvv) - jnp.sqrt(half * half + model.huv**2)


def rotation_to(direction: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3 3"]:
    """Rotation object to world that brings the unit ``direction`` straight down: its third row is −x* (eq. (5))."""
    up = -np.asarray(direction, float)
    sign = np.where(up[..., 2] >= 0, 1.0, -1.0)
    a = -1.0 / (sign + up[..., 2])
    b = up[..., 0] * up[..., 1] * a
    first = np.stack([1 + sign * up[..., 0] ** 2 * a, sign * b, -sign * up[..., 0]], axis=-1)
    second = np.stack([b, sign + up[..., 1] ** 2 * a, -up[..., 1]], axis=-1)
    return np.stack([first, second, up], axis=-2)


@cache
def fibonacci_sphere(count: int) -> Float[np.ndarray, "count 3"]:
    """``count`` unit vectors spread evenly by the golden angle (read-only)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    around = np.sqrt(1 - z * z)
    points = np.stack([around * np.cos(angle), around * np.sin(angle), z], axis=1)
    points.flags.writeable = False
    return points


def _sinks(topples_to: Int[np.ndarray, " F"]) -> Int[np.ndarray, " F"]:
    """The facet where toppling from each facet ends; each topple lowers the centre of mass, so it does end."""
    sinks = topples_to
    while True:
        further = sinks[sinks]
        if (further == sinks).all():
            return sinks
        sinks = further


def _ranked(
    faces: Facets,
    resting: Int[np.ndarray, " r"],
    sinks: Int[np.ndarray, " F"],
    facet: Int[np.ndarray, " K"],
    curvature: Float[np.ndarray, " K"],
    uniform: Float[np.ndarray, "k 3"],
    corners: Float[np.ndarray, "V 3"],
) -> StablePoses:
    count = len(uniform)
    number = len(faces.normals)
    own = slice(count, count + len(resting))
    stability = np.zeros(number)
    stability[resting] = np.where(facet[own] == resting, np.maximum(curvature[own], 0.0), 0.0)
    hits = np.bincount(facet[:count], minlength=number)

    first, second = sinks[faces.edges[:, 0]], sinks[faces.edges[:, 1]]
    rim = first != second
    lowest = np.full(number, np.inf)
    np.minimum.at(lowest, first[rim], faces.passes[rim])
    np.minimum.at(lowest, second[rim], faces.passes[rim])

    order = resting[np.argsort(-stability[resting], kind="stable")]
    index = np.full(number, -1)
    index[order] = np.arange(len(order))
    return StablePoses(
        directions=faces.normals[order],
        rotations=rotation_to(faces.normals[order]),
        stability=stability[order],
        probability=hits[order] / count,
        margin=faces.margins[order],
        barrier=lowest[order] - faces.heights[order],
        height=faces.heights[order],
        starts=uniform,
        basin=index[facet[:count]],
        corners=corners,
        ridges=faces.edge_ends[rim],
        ridge_poses=index[np.stack([first[rim], second[rim]], axis=1)],
    )
