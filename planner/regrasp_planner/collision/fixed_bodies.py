"""Distances of bodies at many poses from bodies that stay in place: bounds on the host, then exact ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial.transform import RigidTransform

from regrasp_planner.batching import bucket_size, in_batches
from regrasp_planner.collision.least_slack import least_slack
from regrasp_planner.geometry.distance import certified_distance
from regrasp_planner.geometry.hull import hull_planes
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.pose import rigid, wxyz_xyz

VERTEX_BUCKETS = (16, 64)
DISTANCE_BATCH = 512
"""Pairs measured in one call of the compiled program."""


class FixedBodies:
    """W bodies at fixed poses, with their spheres and facet planes in the world, which bound distances from them.

    Args:
        bodies: W bodies, each in its own frame.
        poses: (W, 7) their poses, metres.
    """

    def __init__(self, bodies: Sequence[ConvexBody], poses: Float[np.ndarray, "W 7"]):
        self.bodies, self.poses = tuple(bodies), poses
        placed = [rigid(pose) for pose in poses]
        corners = [at.apply(body.hull_vertices()) for body, at in zip(bodies, placed, strict=True)]
        swept = [np.array([0.0, 0.0, 0.0, float(body.radius)]) for body in bodies]
        self._planes = [hull_planes(points) + sweep for points, sweep in zip(corners, swept, strict=True)]
        spheres = [_bounding_sphere(body) for body in bodies]
        self._centers = np.array([at.apply(center) for (center, _), at in zip(spheres, placed, strict=True)])
        self._radii = np.array([radius for _, radius in spheres])
        self._stacked = _stacked(bodies) if bodies else None

    def least_slack(
        self,
        moving: Sequence[ConvexBody],
        placed: Sequence[RigidTransform],
        needed: Float[np.ndarray, "M W"],
        cap: float = 0.0,
    ) -> Float[np.ndarray, " n"]:
        """Smallest distance − needed over all pairs, for each of n poses of the moving bodies.

        Args:
            moving: M bodies.
            placed: n poses of each.
            needed: (M, W) distance that each pair has to keep, metres; −∞ for pairs that may touch.
            cap: larger values are not resolved, metres.

        Returns:
            (n,) metres. Values from 0 to ``cap`` are exact: the distances of the hulls, or at most 0.1 mm less. Any
            negative value means that a pair is nearer than needed; it need not be the smallest.
        """
        count = len(placed[0])
        if count == 0 or not self.bodies:
            return np.full(count, float(cap))
        bounds = np.stack([self._bounds(m, at, row, cap) for m, at, row in zip(moving, placed, needed, strict=True)], 1)
        bounds = bounds.reshape(count, -1)
        poses = np.stack([wxyz_xyz(at) for at in placed], axis=1)
        stack, flat = _stacked(moving), needed.reshape(-1)

        def slack(rows: Int[np.ndarray, " L"], pairs: Int[np.ndarray, " L"]) -> Float[np.ndarray, " L"]:
            m, w = np.divmod(pairs, len(self.bodies))
            fixed = self._stacked
            assert fixed is not None

            def distances(some: Int[np.ndarray, " D"]) -> Float[Array, " D"]:
                i, k = m[some], w[some]
                # One local maximum is enough: how deep bodies overlap does not matter.
                return certified_distance(stack[i], poses[rows[some], i], fixed[k], self.poses[k], thorough=False)

            return in_batches(distances, len(pairs), DISTANCE_BATCH) - flat[pairs]

        return least_slack(bounds, slack, cap)[0]

    def _bounds(
        self, body: ConvexBody, placed: RigidTransform, needed: Float[np.ndarray, " W"], cap: float
    ) -> Float[np.ndarray, "n W"]:
        """Lower bounds of distance − needed: by spheres and, where those are below ``cap``, by the facets' planes."""
        center, extent = _bounding_sphere(body)
        offsets = placed.apply(center)[:, None] - self._centers
        slack = np.sqrt((offsets**2).sum(axis=2)) - extent - self._radii - needed
        vertices, radius = body.hull_vertices(), float(body.radius)
        turned = np.einsum("nij,vj->nvi", placed.rotation.as_matrix(), vertices) + placed.translation[:, None]
        for k, planes in enumerate(self._planes):
            rows = np.flatnonzero(slack[:, k] < cap)
            heights = (turned[rows] @ planes[:, :3].T).min(axis=1) - planes[:, 3]
            slack[rows, k] = np.maximum(slack[rows, k], heights.max(axis=1) - radius - needed[k])
        return slack


def _bounding_sphere(body: ConvexBody) -> tuple[Float[np.ndarray, " 3"], float]:
    """Sphere about the middle of the box, smaller than `ConvexBody.bounding_sphere`, which is about the centre."""
    vertices = body.hull_vertices()
    center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    return center, float(np.linalg.norm(vertices - center, axis=1).max() + body.radius)


def _stacked(bodies: Sequence[ConvexBody]) -> ConvexBody:
    stack = ConvexBody.stack(bodies)
    return stack.padded_to(vertices=bucket_size(stack.vertices.shape[-2], VERTEX_BUCKETS))
