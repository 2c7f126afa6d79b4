"""Distances of bodies at many poses from bodies that stay where they are: bounds on the host, then exact ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import RigidTransform

from regrasp_planner.batching import bucket_size
from regrasp_planner.collision.least_slack import least_slack
from regrasp_planner.geometry.distance import certified_distance
from regrasp_planner.geometry.hull import hull_planes
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.pose import rigid, wxyz_xyz

VERTEX_BUCKETS = (16, 64)
CHUNK = 512
"""Pairs measured in one call of the compiled program."""


class FixedBodies:
    """W bodies at given poses, with what bounds of distances from them need."""

    def __init__(self, bodies: Sequence[ConvexBody], poses: Float[np.ndarray, "W 7"]):
        self.bodies, self.poses = tuple(bodies), poses
        placed = [rigid(pose) for pose in poses]
        corners = [at.apply(body.hull_vertices()) for body, at in zip(bodies, placed, strict=True)]
        swept = [np.array([0.0, 0.0, 0.0, float(body.radius)]) for body in bodies]
        self._planes = [hull_planes(points) + sweep for points, sweep in zip(corners, swept, strict=True)]
        self._spheres = np.zeros((len(bodies), 4))
        for k, (body, at) in enumerate(zip(bodies, placed, strict=True)):
            center, reach = _sphere(body)
            self._spheres[k] = *at.apply(center), reach
        self._stacked = _stacked(bodies) if bodies else None

    def least_slack(
        self,
        moving: Sequence[ConvexBody],
        placed: Sequence[RigidTransform],
        needed: Float[np.ndarray, "M W"],
        cap: float = 0.0,
    ) -> Float[np.ndarray, " n"]:
        """Least of distance − needed over all pairs, for each of n placements of the moving bodies.

        Args:
            moving: M bodies.
            placed: n poses of each.
            needed: distance asked for between each two bodies, metres; −∞ where none is.
            cap: values above are not resolved, metres.

        Returns:
            (n,) metres: exact between 0 and ``cap``; below 0 some negative value, where a pair is nearer than needed.
            Distances are those of the hulls, or at most 0.1 mm less.
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
            assert self._stacked is not None
            return _distances(stack, m, poses[rows, m], self._stacked, w, self.poses[w]) - flat[pairs]

        return least_slack(bounds, slack, cap)[0]

    def _bounds(
        self, body: ConvexBody, placed: RigidTransform, needed: Float[np.ndarray, " W"], cap: float
    ) -> Float[np.ndarray, "n W"]:
        """Lower bounds of distance − needed: by spheres, and by facets' planes where those say less than ``cap``."""
        middle, reach = _sphere(body)
        offsets = placed.apply(middle)[:, None] - self._spheres[:, :3]
        slack = np.sqrt((offsets**2).sum(axis=2)) - reach - self._spheres[:, 3] - needed
        vertices, radius = body.hull_vertices(), float(body.radius)
        turned = np.einsum("nij,vj->nvi", placed.rotation.as_matrix(), vertices) + placed.translation[:, None]
        for k, planes in enumerate(self._planes):
            rows = np.flatnonzero(slack[:, k] < cap)
            heights = (turned[rows] @ planes[:, :3].T).min(axis=1) - planes[:, 3]
            slack[rows, k] = np.maximum(slack[rows, k], heights.max(axis=1) - radius - needed[k])
        return slack


def _sphere(body: ConvexBody) -> tuple[Float[np.ndarray, " 3"], float]:
    vertices = body.hull_vertices()
    center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    return center, float(np.linalg.norm(vertices - center, axis=1).max() + body.radius)


def _stacked(bodies: Sequence[ConvexBody]) -> ConvexBody:
    stack = ConvexBody.stack(bodies)
    return stack.padded_to(vertices=bucket_size(stack.vertices.shape[-2], VERTEX_BUCKETS))


def _distances(
    first: ConvexBody,
    a: Int[np.ndarray, " L"],
    poses_a: Float[np.ndarray, "L 7"],
    second: ConvexBody,
    b: Int[np.ndarray, " L"],
    poses_b: Float[np.ndarray, "L 7"],
) -> Float[np.ndarray, " L"]:
    result = np.zeros(len(a))
    for begin in range(0, len(a), CHUNK):
        some = begin + np.minimum(np.arange(CHUNK), len(a) - begin - 1)
        # One local maximum is enough: how deep bodies overlap does not matter.
        gaps = certified_distance(first[a[some]], poses_a[some], second[b[some]], poses_b[some], thorough=False)
        result[begin : begin + CHUNK] = np.asarray(gaps)[: len(a) - begin]
    return result
