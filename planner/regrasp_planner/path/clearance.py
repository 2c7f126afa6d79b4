"""Clearance along one path: which distance each pair of bodies has to keep, and which configurations keep it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from regrasp_planner.collision.least_slack import least_slack
from regrasp_planner.path.pair_distances import PairDistancer, PairDistances
from regrasp_planner.path.space import ConfigurationSpace

RELIEF_SLOPE = 0.05
"""Growth of the required margin with the joint distance from an end of the path, metres per radian."""
_TOUCH = 2e-4
"""How much deeper (metres) than at the end itself a pair already in contact there may get close to that end."""


@dataclass(frozen=True)
class Collision:
    """Where a path fails.

    Attributes:
        pair: index of the pair of bodies in the collision model.
        configuration: (n,) radians.
        distance: of the exact hulls (a lower bound), metres.
    """

    pair: int
    configuration: Float[np.ndarray, " n"]
    distance: float


@dataclass(frozen=True)
class _End:
    """An end of the path.

    Attributes:
        configuration: (n,) radians.
        distance, certified: (P,) of the pairs that are closer than their margin there, metres; inf for the others.
    """

    configuration: Float[np.ndarray, " n"]
    distance: Float[np.ndarray, " P"]
    certified: Float[np.ndarray, " P"]


@dataclass(frozen=True)
class PathClearance:
    """The distance that each pair of bodies has to keep along a path.

    At its ends a path may have to be nearer to something than the margin: an object held just above the table, fingers
    beside the next object. There the margin of such a pair is the distance at that end. It grows from it by
    `RELIEF_SLOPE` metres per radian of joint motion until it is the full margin again; so the path must leave, and not
    slide along. `path_clearance` makes one without ends, `between` one with.

    Attributes:
        space: the configuration space.
        pairs: measures distances in it.
        valid: (P,) false for padding.
        floor: (P,) distance below which a pair overlaps more than it may, metres: 0, or the margin if that is negative.
        margin: (P,) distance to keep away from the ends, metres.
        ends: the ends of the path.
    """

    space: ConfigurationSpace
    pairs: PairDistancer
    valid: Bool[np.ndarray, " P"]
    floor: Float[np.ndarray, " P"]
    margin: Float[np.ndarray, " P"]
    ends: tuple[_End, ...] = ()

    def between(self, start: Float[np.ndarray, " n"], goal: Float[np.ndarray, " n"]) -> PathClearance:
        """The same for a path with these ends, where margins are relieved."""
        q = np.stack([start, goal])
        found = self.measure(q, self.margin)
        ends: list[_End] = []
        for i in range(2):
            distance, certified = np.full((2, len(self.margin)), np.inf)
            rows = (found.sample == i) & (found.distance < self.margin[found.pair])
            distance[found.pair[rows]] = found.distance[rows]
            certified[found.pair[rows]] = found.certified[rows]
            ends.append(_End(q[i], distance, certified))
        return replace(self, ends=tuple(ends))

    def required(self, q: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N P"]:
        """Distance (N, P) that each pair has to keep at each configuration, metres."""
        out = np.repeat(self.margin[None], len(q), axis=0)
        for end in self.ends:
            relieved = np.flatnonzero(np.isfinite(end.distance))
            away = RELIEF_SLOPE * np.linalg.norm(q - end.configuration, axis=1)
            out[:, relieved] = np.minimum(out[:, relieved], end.distance[relieved] + away[:, None])
        return out

    def contact_floor(self, q: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N P"]:
        """Least distance (N, P) of pairs whose margin an end relieves, near that end, metres; inf elsewhere."""
        out = np.full((len(q), len(self.margin)), np.inf)
        for end in self.ends:
            relieved = np.flatnonzero(np.isfinite(end.distance))
            exact, floor = end.certified[relieved], self.floor[relieved]
            zone = (self.margin[relieved] - end.distance[relieved]) / RELIEF_SLOPE
            near = np.linalg.norm(q - end.configuration, axis=1)[:, None] <= zone
            least = np.where(exact >= floor, floor, exact - _TOUCH)
            out[:, relieved] = np.minimum(out[:, relieved], np.where(near, least, np.inf))
        return out

    def measure(self, q: Float[np.ndarray, "N n"], below: Float[np.ndarray, "*N P"]) -> PairDistances:
        """Every pair that may be nearer than ``below`` (P,) or (N, P) metres at a configuration."""
        at = self.pairs.bounds(q)
        return self.pairs.measure(at, *np.nonzero((at.bounds < below) & self.valid))

    def free(self, q: Float[np.ndarray, "N n"]) -> Bool[np.ndarray, " N"]:
        """Which configurations keep all required distances."""
        required, at = self.required(q), self.pairs.bounds(q)

        def slack(rows: Int[np.ndarray, " L"], pairs: Int[np.ndarray, " L"]) -> Float[np.ndarray, " L"]:
            return self.pairs.measure(at, rows, pairs).distance - required[rows, pairs]

        return least_slack(np.where(self.valid, at.bounds - required, np.inf), slack)[0] >= 0

    def deepest_overlap(
        self, q: Float[np.ndarray, "N n"], allowed: float | Float[np.ndarray, " P"] = 0.0
    ) -> Collision | None:
        """The deepest overlap of the exact hulls over configurations, beyond what is ``allowed`` (metres), or None."""
        floor = self.floor - allowed
        found = self.measure(q, floor)
        beyond = found.certified - floor[found.pair]
        return collision_at(found, int(beyond.argmin()), q) if beyond.min(initial=0.0) < 0 else None


def path_clearance(space: ConfigurationSpace, extra_margin: float = 0.0) -> PathClearance:
    """What a path in this space has to keep clear of.

    Args:
        space: the configuration space.
        extra_margin: added to each positive margin, metres; an optimiser needs some to keep the margin itself.
    """
    margin = np.asarray(space.model.arrays.margin, float)
    return PathClearance(
        space,
        PairDistancer(space),
        valid=np.asarray(space.model.arrays.valid),
        floor=np.minimum(margin, 0.0),
        margin=np.where(margin > 0, margin + extra_margin, margin),
    )


def collision_at(found: PairDistances, row: int, q: Float[np.ndarray, "N n"]) -> Collision:
    """One row of the measured distances as a collision, given the configurations it indexes."""
    return Collision(int(found.pair[row]), q[found.sample[row]], float(found.certified[row]))
