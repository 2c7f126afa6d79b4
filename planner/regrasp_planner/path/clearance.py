"""Clearances along a path: which pairs of bodies come near, how near, and a certificate that nothing touches between.

Two compiled programs serve every query of a robot. `survey_pairs` bounds every pair at every configuration from below;
`measure_pairs` gives distances and gradients of the few pairs the survey leaves open, as one flat batch.

Motion bound. A body point turns with joint j at a radius of at most ρ_j (distance from the joint's axis to the body's
bounding ball, plus its radius) at the configuration at hand. On the way to another configuration ρ_j can grow by no
more than the motion m itself, so m ≤ Σ_j |Δq_j| (ρ_j + m), hence m ≤ Σ_j |Δq_j| ρ_j / (1 − Σ_j |Δq_j|); only the
joints between the two bodies of a pair count. A pair whose exact distance at a configuration is larger than m cannot
touch on the way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from regrasp_planner.collision.model import CollisionModel
from regrasp_planner.path.pairs import chain_of_pairs, measure_pairs, survey_pairs
from regrasp_planner.path.trajectory import Trajectory
from regrasp_planner.path.trajectory_course import Course

_CONFIGURATIONS = 32
"""Configurations surveyed at once: their pairs stay in the cache."""
_ROWS = 128
"""Rows measured at once: fewer waste the vector units, more wait for the slowest and fall out of the cache."""
_FEW_VERTICES = 8
"""Boxes and capsules: pairs of bodies with at most this many vertices are measured apart, without the padding."""
RELIEF_SLOPE = 0.05
"""Growth of the required margin with the joint distance from an end of the path, metres per radian."""
_TOUCH = 2e-4
"""How much deeper (metres) than at the end itself a pair already in contact there may get close to that end."""
_COARSE = 48
"""Intervals that the certificate begins with."""
_MAX_DEPTH = 14
_FINEST = 5e-4
"""Motion (metres) between neighbouring checked configurations below which a contact pair needs no certificate."""


@dataclass(frozen=True)
class Survey:
    """What all pairs do at N configurations.

    Attributes:
        q: (N, n) radians.
        bounds: (N, P) lower bounds of the distances, metres.
        radius: (N, M, n) largest distance of a body's points from each joint's axis, metres.
        poses: (N, M, 7) world poses of all bodies.
        axis, point: (N, n, 3) each joint's axis and a point on it, in the world.
    """

    q: Float[np.ndarray, "N n"]
    bounds: Float[np.ndarray, "N P"]
    radius: Float[np.ndarray, "N M n"]
    poses: Float[np.ndarray, "N M 7"]
    axis: Float[np.ndarray, "N n 3"]
    point: Float[np.ndarray, "N n 3"]


@dataclass(frozen=True)
class Measured:
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

    def collision(self, row: int, q: Float[np.ndarray, "N n"]) -> Collision:
        """One row as a collision, given the configurations it indexes."""
        sample = int(self.sample[row])
        return Collision(int(self.pair[row]), q[sample], float(self.certified[row]), sample)


@dataclass(frozen=True)
class _End:
    """An end of the path: its configuration, and the distances (P,) of pairs closer than their margin (inf: others)."""

    configuration: Float[np.ndarray, " n"]
    distance: Float[np.ndarray, " P"]
    certified: Float[np.ndarray, " P"]


@dataclass(frozen=True)
class Collision:
    """Where a path fails: the pair of bodies, the configuration, and their distance there.

    Attributes:
        pair: index of the pair in the collision model.
        configuration: (n,) radians.
        distance: metres, of the exact hulls (a lower bound).
        sample: index of the configuration among those asked about.
    """

    pair: int
    configuration: Float[np.ndarray, " n"]
    distance: float
    sample: int


class PathClearance:
    """Clearance of a robot (its fingers at θ, perhaps with a held body) among obstacles, for one path query.

    At its ends a path may have to be nearer to something than the margin: an object held just above the table, fingers
    beside the next object. There the margin of such a pair is what the end has, and grows from it by `RELIEF_SLOPE`
    metres per radian of joint motion until it is the full margin again; so the path must leave, and not slide along.

    Args:
        model: bodies, pairs and margins.
        theta: finger coordinate.
        extra_margin: metres added to each pair's margin (what an optimiser needs so that its result keeps the margin).
    """

    def __init__(self, model: CollisionModel, theta: float, extra_margin: float = 0.0):
        self.model, self.theta = model, float(theta)
        arrays = model.arrays
        self.valid: Bool[np.ndarray, " P"] = np.asarray(arrays.valid)
        margin = np.asarray(arrays.margin, float)
        # A negative margin allows that much overlap; "touching" then starts there.
        self.floor: Float[np.ndarray, " P"] = np.minimum(margin, 0.0)
        self.margin: Float[np.ndarray, " P"] = np.where(margin > 0, margin + extra_margin, margin)
        self.pair_count = len(margin)
        self._joints, self._far = chain_of_pairs(model)
        self._bodies = jax.tree.map(np.asarray, arrays.bodies)
        # Padding vertices come last.
        self._few = replace(self._bodies, vertices=self._bodies.vertices[:, :_FEW_VERTICES])
        rest = self._bodies.vertices[:, _FEW_VERTICES:] != self._bodies.center[:, None]
        self._simple = ~rest.any(axis=(1, 2))[model.pairs].any(axis=1)
        self._ends: list[_End] = []

    def set_ends(self, start: Float[np.ndarray, " n"], goal: Float[np.ndarray, " n"]) -> None:
        """Take the clearances at the ends of the path as the relieved margins there."""
        ends = np.stack([start, goal])
        found = self.measure(ends, self.margin)
        self._ends = []
        for i, q in enumerate(ends):
            distance, certified = np.full((2, self.pair_count), np.inf)
            rows = (found.sample == i) & (found.distance < self.margin[found.pair])
            distance[found.pair[rows]] = found.distance[rows]
            certified[found.pair[rows]] = found.certified[rows]
            self._ends.append(_End(q, distance, certified))

    def required(self, q: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N P"]:
        """Distance (N, P) that each pair has to keep at each configuration, metres."""
        out = np.repeat(self.margin[None], len(q), axis=0)
        for end in self._ends:
            relieved = np.flatnonzero(np.isfinite(end.distance))
            away = RELIEF_SLOPE * np.linalg.norm(q - end.configuration, axis=1)
            out[:, relieved] = np.minimum(out[:, relieved], end.distance[relieved] + away[:, None])
        return out

    def survey(self, q: Float[np.ndarray, "N n"]) -> Survey:
        """Bounds of all pairs at N configurations, (N, n) radians."""
        parts: list[list[np.ndarray]] = []
        for start in range(0, len(q), _CONFIGURATIONS):
            block = q[start : start + _CONFIGURATIONS]
            out = survey_pairs(self.model.arrays, _pad(block, _CONFIGURATIONS), self.theta)
            bounds, *rest = (np.asarray(array) for array in out)
            parts.append([array[: len(block)] for array in (bounds.T, *rest)])
        joined = [arrays[0] if len(parts) == 1 else np.concatenate(arrays) for arrays in zip(*parts, strict=True)]
        return Survey(q, *joined)

    def motion(
        self, radius: Float[np.ndarray, "I M n"], variation: Float[np.ndarray, "I n"]
    ) -> Float[np.ndarray, "I P"]:
        """Bounds (I, P) of how far the bodies of each pair move against each other, metres.

        Args:
            radius: (I, M, n) of `Survey`, where each motion begins.
            variation: (I, n) how far each joint turns, radians.
        """
        moves = np.abs(self._joints)
        swing = np.einsum("pj,ipj->ip", moves, (radius * variation[:, None])[:, self._far])
        # Beyond a radian of turning the bound says nothing useful; the floor only keeps it finite.
        return swing / np.maximum(1.0 - variation @ moves.T, 1e-6)

    def measure_rows(self, survey: Survey, sample: Int[np.ndarray, " R"], pair: Int[np.ndarray, " R"]) -> Measured:
        """Distances and gradients of the given (configuration, pair) rows of a survey."""
        count, n = len(sample), survey.q.shape[1]
        distance, certified, gradient = np.empty(count), np.empty(count), np.empty((count, n))
        a, b = self.model.pairs[pair].T
        simple = self._simple[pair]
        for bodies, chosen in ((self._few, np.flatnonzero(simple)), (self._bodies, np.flatnonzero(~simple))):
            for start in range(0, len(chosen), _ROWS):
                part = chosen[start : start + _ROWS]
                rows = _pad(part, _ROWS)
                i, first, second = sample[rows], a[rows], b[rows]
                poses = survey.poses[i, first], survey.poses[i, second]
                turns = self._joints[pair[rows]], survey.axis[i], survey.point[i]
                # Gathered here and not in the program, which is then the same for every scene and robot.
                out = measure_pairs(bodies[first], bodies[second], *poses, *turns)
                keep = len(part)
                distance[part], certified[part], gradient[part] = (np.asarray(array)[:keep] for array in out)
        return Measured(sample, pair, distance, certified, gradient)

    def measure(self, q: Float[np.ndarray, "N n"], below: Float[np.ndarray, "*N P"]) -> Measured:
        """Every pair that may be nearer than ``below`` (P,) or (N, P) metres at a configuration."""
        survey = self.survey(q)
        sample, pair = np.nonzero((survey.bounds < below) & self.valid)
        return self.measure_rows(survey, sample, pair)

    def free(self, q: Float[np.ndarray, "N n"]) -> Bool[np.ndarray, " N"]:
        """Which configurations keep all required distances."""
        required = self.required(q)
        survey = self.survey(q)
        open_rows = (survey.bounds < required) & self.valid
        ok = np.ones(len(q), bool)
        # The pair with the lowest bound first: most configurations in collision need no second look.
        worst = np.where(open_rows, survey.bounds, np.inf).argmin(axis=1)
        suspects = np.flatnonzero(open_rows.any(axis=1))
        first = self.measure_rows(survey, suspects, worst[suspects])
        ok[suspects] = first.distance >= required[suspects, worst[suspects]]
        open_rows[suspects, worst[suspects]] = False
        open_rows[~ok] = False
        sample, pair = np.nonzero(open_rows)
        rest = self.measure_rows(survey, sample, pair)
        ok[sample[rest.distance < required[sample, pair]]] = False
        return ok

    def touching(self, q: Float[np.ndarray, "N n"], allowed: float | Float[np.ndarray, " P"] = 0.0) -> Collision | None:
        """The deepest overlap of the exact hulls over configurations, beyond what is ``allowed`` (metres), or None."""
        floor = self.floor - allowed
        found = self.measure(q, floor)
        beyond = found.certified - floor[found.pair]
        if not len(beyond) or beyond.min() >= 0:
            return None
        return found.collision(int(beyond.argmin()), q)

    def certify(self, trajectory: Trajectory) -> tuple[Collision | None, float]:
        """Check a whole trajectory, between its samples too, against the exact hulls.

        On the way through an interval two bodies can close in by m₀ from its beginning and by m₁ from its end, with
        m₀ + m₁ ≤ M, the bound of their motion over the interval (joints' variation from the control polygon of the
        Hermite cubic). So they cannot touch if their distances at the two ends sum to more than M. Intervals that do
        not pass are halved. A pair already closer than its margin at an end of the path cannot pass at that end; for
        it, and only while its margin is relieved there, it is enough that configurations no more than 0.5 mm of motion
        apart do not overlap, or, if the end itself does, not by 0.2 mm more than the end.

        Returns:
            A collision (None: the path is free), and the smallest certified distance met outside the relieved pairs,
            metres (inf where nothing came near).
        """
        course = Course(trajectory)
        begin, end = course.begin(_COARSE)
        nearest = np.inf
        for depth in range(_MAX_DEPTH + 1):
            closest, doubtful, collision = self._check_intervals(course, begin, end, depth == _MAX_DEPTH)
            nearest = min(nearest, closest)
            if collision is not None or not doubtful.any():
                return collision, nearest
            begin, end = course.halved(begin[doubtful], end[doubtful])
        raise AssertionError("the last depth decides every interval")

    def _check_intervals(
        self, course: Course, begin: Float[np.ndarray, " I"], end: Float[np.ndarray, " I"], last: bool
    ) -> tuple[float, Bool[np.ndarray, " I"], Collision | None]:
        """(smallest certified distance, intervals left open, collision) of some intervals of a trajectory."""
        times, where = np.unique(np.concatenate([begin, end]), return_inverse=True)
        left, right = where[: len(begin)], where[len(begin) :]
        q = course.trajectory.at(times)
        survey = self.survey(q)
        relieved = self._contact_floor(q)
        floor = np.where(np.isfinite(relieved), relieved, self.floor)
        # Slack above touching, from the cheap bounds first.
        slack = np.where(self.valid, survey.bounds - self.floor, np.inf)
        motion = self.motion(survey.radius[left], course.variation(begin, end))
        near = slack[left] + slack[right] <= motion
        needed = slack < 0
        np.logical_or.at(needed, left, near)
        np.logical_or.at(needed, right, near)
        sample, pair = np.nonzero(needed)
        found = self.measure_rows(survey, sample, pair)
        slack[sample, pair] = found.certified - self.floor[pair]
        plain = ~np.isfinite(relieved[sample, pair])
        closest = float(found.certified[plain].min(initial=np.inf))
        hit = np.flatnonzero(found.certified < floor[sample, pair])
        if len(hit):
            r = int(hit[np.argmin(times[sample[hit]])])
            return closest, np.zeros(len(begin), bool), found.collision(r, q)
        passed = slack[left] + slack[right] > motion
        passed |= np.isfinite(relieved[left]) & np.isfinite(relieved[right]) & (motion < _FINEST)
        doubtful: Bool[np.ndarray, " I"] = np.logical_not(passed.all(axis=1))
        if last and doubtful.any():
            i = int(np.flatnonzero(doubtful)[0])
            k = int(np.where(passed[i], np.inf, slack[left[i]]).argmin())
            sure = float(slack[left[i], k] + self.floor[k])
            return closest, doubtful, Collision(k, q[left[i]], sure, int(left[i]))
        return closest, doubtful, None

    def _contact_floor(self, q: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N P"]:
        """Least distance allowed to pairs that start or end closer than their margin, near that end; inf elsewhere."""
        out = np.full((len(q), self.pair_count), np.inf)
        for end in self._ends:
            relieved = np.flatnonzero(np.isfinite(end.distance))
            exact, floor = end.certified[relieved], self.floor[relieved]
            zone = (self.margin[relieved] - end.distance[relieved]) / RELIEF_SLOPE
            near = np.linalg.norm(q - end.configuration, axis=1)[:, None] <= zone
            least = np.where(exact >= floor, floor, exact - _TOUCH)
            out[:, relieved] = np.minimum(out[:, relieved], np.where(near, least, np.inf))
        return out


def _pad(values: np.ndarray, size: int) -> np.ndarray:
    """Repeat the last entry up to ``size``."""
    return np.concatenate([values, np.repeat(values[-1:], size - len(values), axis=0)])
