"""StabPose: the poses in which a released object comes to rest on a horizontal plane.

Let x be the direction, in the object's frame, that points down. The height of the centre of mass above the plane is the
support function h(x) about the centre of mass, and the object settles into local minima of h on the sphere (eq. (6);
Proposition 1 for the descent). h is smoothed to a DSF, minimised from many starts by Riemannian Newton steps within a
trust region, and tested by the Riemannian Hessian Pᵀ∇²hP − h·I (eq. (7), Algorithm 2).

A DSF at finite sharpness moves minima, and at low sharpness loses some. So descent from a start only decides on which
facet of the exact hull the object falls: the one pierced by the ray along x from the centre of mass. The pose is the
normal of the facet where toppling from there ends, and counts only if the foot of the centre of mass lies inside that
facet. Every such facet also gets a start of its own, so that rare poses are not lost; a pose that no uniform start
reaches has probability 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import ConvexHull

from regrasp_planner.batching import bucket_size
from regrasp_planner.errors import GeometryError
from regrasp_planner.geometry.ascent import Model, climb, core_terms, quadratic, tangent_basis
from regrasp_planner.geometry.hull import Facets, facets, qhull
from regrasp_planner.geometry.hull import center_of_mass as solid_center_of_mass

SHARPNESS = 1026
"""Lower values lose poses with a low rim, so there are no stages of lower sharpness."""

LONGEST_STEP = 0.05
"""Longest step, radians: short enough to follow steepest descent without leaping over a rim."""

EVALUATIONS = 10
"""Enough for the facets' own starts to converge, and for 98 % of the others to fall where steepest descent takes them.
More evaluations do not raise that share, as the DSF rounds h off near the end of the descent."""

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
            sharpness `SHARPNESS`; 0 if the rim is so low that the DSF has no minimum. The poses are ranked by it.
        probability: (m,) share of the uniform starts that settle into the pose.
        margin: (m,) distance between the foot of the centre of mass and the rim of the support polygon, metres.
        barrier: (m,) energy barrier: rise of the centre of mass over the lowest rim into another pose, metres.
        height: (m,) height of the centre of mass above the plane, metres.
        starts: (k, 3) the uniform start directions.
        basin: (k,) index of the pose that each start settles into.
        corners: (V, 3) vertices of the hull, seen from the centre of mass, metres.
        ridges: (r, 2, 3) ends of the hull's edges that separate two basins, seen from the centre of mass, metres.
        ridge_poses: (r, 2) index of the pose on either side of each ridge; −1 for a pose that was left out.
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
        vertices: (N, 3) points of the object, metres; a non-convex object stands on its hull.
        center_of_mass: (3,) metres; by default that of the uniform solid hull.
        starts: number of uniformly spread start directions.
        min_margin: least support margin, exclusive, metres.

    Raises:
        GeometryError: the vertices span no volume, the centre of mass is outside their hull, or ``starts`` < 1.
    """
    if starts < 1:
        raise GeometryError(f"starts is {starts}; give at least 1 start direction")
    hull = qhull(vertices)
    center = _checked_center(hull, center_of_mass)
    corners = hull.points[hull.vertices] - center
    faces = facets(hull, center)
    size = float(np.sqrt((corners**2).sum(axis=1).max()))
    resting = np.flatnonzero(faces.margins > max(min_margin, 1e-9 * size))
    uniform = fibonacci_sphere(starts)
    facet, curvature = _descend(faces, resting, uniform, corners)

    number, count = len(faces.normals), len(uniform)
    sinks = _sinks(faces.topples_to)
    facet = sinks[facet]
    stability = np.zeros(number)
    stability[resting] = np.where(facet[count:] == resting, np.maximum(curvature, 0.0), 0.0)
    order = resting[np.argsort(-stability[resting], kind="stable")]
    index = np.full(number, -1)
    index[order] = np.arange(len(order))

    basins = sinks[faces.edges]
    ridges = basins[:, 0] != basins[:, 1]
    lowest_pass = np.full(number, np.inf)
    np.minimum.at(lowest_pass, basins[ridges], faces.passes[ridges, None])
    return StablePoses(
        directions=faces.normals[order],
        rotations=rotation_to(faces.normals[order]),
        stability=stability[order],
        probability=np.bincount(facet[:count], minlength=number)[order] / count,
        margin=faces.margins[order],
        barrier=lowest_pass[order] - faces.heights[order],
        height=faces.heights[order],
        starts=uniform,
        basin=index[facet[:count]],
        corners=corners,
        ridges=faces.edge_ends[ridges],
        ridge_poses=index[basins[ridges]],
    )


def _checked_center(hull: ConvexHull, center_of_mass: Float[np.ndarray, " 3"] | None) -> Float[np.ndarray, " 3"]:
    """The centre of mass, by default that of the uniform solid hull; raises ``GeometryError`` if it is not inside."""
    center = solid_center_of_mass(hull) if center_of_mass is None else np.asarray(center_of_mass, float)
    if center.shape != (3,) or not np.isfinite(center).all():
        raise GeometryError(f"centre of mass is {center_of_mass}; give three finite coordinates in metres")
    depth = -(hull.equations[:, :3] @ center + hull.equations[:, 3]).max()
    size = np.linalg.norm(hull.points[hull.vertices] - center, axis=1).max()
    if depth <= 1e-6 * size:
        raise GeometryError(
            f"centre of mass {center} is {-depth:.3g} m outside the hull of the vertices; give it in their frame"
        )
    return center


def _descend(
    faces: Facets, resting: Int[np.ndarray, " r"], uniform: Float[np.ndarray, "k 3"], corners: Float[np.ndarray, "V 3"]
) -> tuple[Int[np.ndarray, " K"], Float[np.ndarray, " r"]]:
    """Minimise the DSF from the uniform starts, then from the normals of the facets to rest on.

    Returns:
        (k + r,) the facet that each start falls onto, and (r,) the least eigenvalue of the Riemannian Hessian at the
        end of each start from a facet, metres per rad².
    """
    count, own = len(uniform), slice(len(uniform), len(uniform) + len(resting))
    begin = np.tile(uniform[0], (count + bucket_size(max(len(resting), LEAST_EXTRA)), 1))
    begin[:count], begin[own] = uniform, faces.normals[resting]
    padded = np.zeros((bucket_size(len(corners)), 3))
    padded[: len(corners)] = corners
    ends, curvature = (np.asarray(out) for out in settle(padded.T, begin.T))
    along = ends.T @ faces.normals.T
    pierced = (along[:count] / faces.heights).argmax(axis=1)
    return np.concatenate([pierced, along[own].argmax(axis=1)]), curvature[own]


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
    """Rotation from object to world that turns the unit ``direction`` straight down: its third row is −x* (eq. (5))."""
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
    """The facet where toppling from each facet ends. It does end, as each topple lowers the centre of mass."""
    sinks = topples_to
    while True:
        following = sinks[sinks]
        if (following == sinks).all():
            return sinks
        sinks = following
