"""Distances of the pairs of a collision model at many configurations: bounds of all, exact figures of a few.

Two compiled programs serve every query of a robot. `bound_pairs` bounds every pair at every configuration from below;
`measure_pairs` gives distances and gradients of the few pairs the bounds leave open, as one flat batch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float, Int

from regrasp_planner.path.pair_kernels import bound_pairs, chain_of_pairs, measure_pairs
from regrasp_planner.path.space import ConfigurationSpace
from regrasp_planner.robot.kinematics import JointAxes

_CONFIGURATIONS = 32
"""Configurations bounded at once: their pairs stay in the cache."""
_ROWS = 128
"""Rows measured at once: fewer waste the vector units, more wait for the slowest and fall out of the cache."""
_FEW_VERTICES = 8
"""Boxes and capsules: pairs of bodies with at most this many vertices are measured apart, without the padding."""


@dataclass(frozen=True)
class PairBounds:
    """Bounds of all pairs at N configurations, with the kinematics behind them.

    Attributes:
        bounds: (N, P) lower bounds of the distances, metres.
        radius: (N, M, n) largest distance of a body's points from each joint's axis, metres.
        poses: (N, M, 7) world poses of all bodies.
        joints: the joints' axes in the world.
    """

    bounds: Float[np.ndarray, "N P"]
    radius: Float[np.ndarray, "N M n"]
    poses: Float[np.ndarray, "N M 7"]
    joints: JointAxes


@dataclass(frozen=True)
class PairDistances:
    """Distances of pairs at configurations, row by row.

    Attributes:
        sample, pair: (R,) indices of the configuration and of the pair.
        distance: (R,) by the support functions, metres.
        certified: (R,) lower bound of the distance of the exact hulls, metres.
        gradient: (R, n) of the distance by the joints, m/rad.
    """

    sample: Int[np.ndarray, " R"]
    pair: Int[np.ndarray, " R"]
    distance: Float[np.ndarray, " R"]
    certified: Float[np.ndarray, " R"]
    gradient: Float[np.ndarray, "R n"]


class PairDistancer:
    """Bounds and measures the distances of a configuration space's pairs of bodies."""

    def __init__(self, space: ConfigurationSpace):
        self.space = space
        model = space.model
        self._pairs = model.pairs
        self._joints, self._outer = chain_of_pairs(model)
        self._bodies = jax.tree.map(np.asarray, model.arrays.bodies)
        # Padding vertices come last.
        self._few = replace(self._bodies, vertices=self._bodies.vertices[:, :_FEW_VERTICES])
        rest = self._bodies.vertices[:, _FEW_VERTICES:] != self._bodies.center[:, None]
        self._simple = ~rest.any(axis=(1, 2))[self._pairs].any(axis=1)

    def bounds(self, q: Float[np.ndarray, "N n"]) -> PairBounds:
        """Bounds of all pairs at N configurations, (N, n) radians."""
        parts: list[list[np.ndarray]] = []
        for start in range(0, len(q), _CONFIGURATIONS):
            block = q[start : start + _CONFIGURATIONS]
            out = bound_pairs(self.space.model.arrays, _pad(block, _CONFIGURATIONS), self.space.theta)
            bounds, *rest = (np.asarray(array) for array in jax.tree.leaves(out))
            parts.append([array[: len(block)] for array in (bounds.T, *rest)])
        joined = [arrays[0] if len(arrays) == 1 else np.concatenate(arrays) for arrays in zip(*parts, strict=True)]
        bounds, radius, poses, axis, point = joined
        return PairBounds(bounds, radius, poses, JointAxes(axis, point))

    def motion(
        self, radius: Float[np.ndarray, "I M n"], variation: Float[np.ndarray, "I n"]
    ) -> Float[np.ndarray, "I P"]:
        """Bounds (I, P) of how far the bodies of each pair move against each other, metres.

        A body point turns with joint j at a radius of at most ρ_j where the motion begins (distance from the joint's
        axis to the body's bounding ball, plus its radius). On the way ρ_j grows by no more than the motion m itself,
        so m ≤ Σ_j |Δq_j| (ρ_j + m), hence m ≤ Σ_j |Δq_j| ρ_j / (1 − Σ_j |Δq_j|). Only the joints between the two
        bodies of a pair count.

        Args:
            radius: (I, M, n) of `PairBounds`, where each motion begins.
            variation: (I, n) how far each joint turns, radians.
        """
        moves = np.abs(self._joints)
        swing = np.einsum("pj,ipj->ip", moves, (radius * variation[:, None])[:, self._outer])
        # Beyond a radian of turning the bound says nothing useful; the floor only keeps it finite.
        return swing / np.maximum(1.0 - variation @ moves.T, 1e-6)

    def measure(self, at: PairBounds, sample: Int[np.ndarray, " R"], pair: Int[np.ndarray, " R"]) -> PairDistances:
        """Distances and gradients of ``pair[i]`` at configuration ``sample[i]`` of those bounded."""
        count = len(sample)
        distance, certified, gradient = np.empty(count), np.empty(count), np.empty((count, self._joints.shape[1]))
        a, b = self._pairs[pair].T
        simple = self._simple[pair]
        for bodies, chosen in ((self._few, np.flatnonzero(simple)), (self._bodies, np.flatnonzero(~simple))):
            for start in range(0, len(chosen), _ROWS):
                part = chosen[start : start + _ROWS]
                rows = _pad(part, _ROWS)
                i, first, second = sample[rows], a[rows], b[rows]
                poses = at.poses[i, first], at.poses[i, second]
                joints = JointAxes(at.joints.axis[i], at.joints.point[i])
                # Gathered here and not in the program, which is then the same for every scene and robot.
                out = measure_pairs(bodies[first], bodies[second], *poses, self._joints[pair[rows]], joints)
                keep = len(part)
                distance[part], certified[part], gradient[part] = (np.asarray(array)[:keep] for array in out)
        return PairDistances(sample, pair, distance, certified, gradient)


def _pad(values: np.ndarray, size: int) -> np.ndarray:
    """Repeat the last entry up to ``size``."""
    return np.concatenate([values, np.repeat(values[-1:], size - len(values), axis=0)])
