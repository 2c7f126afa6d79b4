"""Bidirectional rapidly exploring random trees (RRT-Connect) over a batched validity test, and shortcutting.

The last resort of path planning: it ignores smoothness but does not get caught in local minima. Kuffner and LaValle,
"RRT-Connect", ICRA 2000; here each round grows many branches at once, because testing 200 configurations in one batch
costs little more than testing 10.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from regrasp_planner.path.polyline import chord_lengths, points_at

Validity = Callable[[Float[np.ndarray, "N n"]], Bool[np.ndarray, " N"]]
"""Which of these configurations are free."""

_BRANCHES, _NEAR_LINE, _NEAR_TREE = 12, 4, 1
_EDGE = 0.8
"""Longest edge of a tree, radians (Euclidean)."""


@dataclass
class _Tree:
    nodes: Float[np.ndarray, "T n"]
    parents: list[int] = field(default_factory=lambda: [-1])

    def nearest(self, targets: Float[np.ndarray, "S n"]) -> Int[np.ndarray, " S"]:
        squared = ((targets[:, None, :] - self.nodes[None]) ** 2).sum(axis=-1)
        return squared.argmin(axis=1)

    def add(self, parents: Int[np.ndarray, " S"], nodes: Float[np.ndarray, "S n"]) -> Int[np.ndarray, " S"]:
        first = len(self.nodes)
        self.nodes = np.concatenate([self.nodes, nodes])
        self.parents.extend(int(p) for p in parents)
        return np.arange(first, first + len(nodes))

    def branch(self, node: int) -> list[int]:
        """Indices from ``node`` to the root."""
        out = [node]
        while self.parents[out[-1]] >= 0:
            out.append(self.parents[out[-1]])
        return out


def rrt_connect(
    start: Float[np.ndarray, " n"],
    goal: Float[np.ndarray, " n"],
    free: Validity,
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    rng: np.random.Generator,
    resolution: float = 0.05,
    max_rounds: int = 150,
    branches: Sequence[Float[np.ndarray, "L n"]] = (),
) -> Float[np.ndarray, "K n"] | None:
    """A polyline from start to goal whose points, every ``resolution`` radians, are free; None if none is found.

    Args:
        start, goal: (n,) free configurations, radians.
        free: batched validity test.
        lower, upper: (n,) limits to sample within.
        rng: source of the samples.
        resolution: largest joint step between tested configurations, radians.
        max_rounds: rounds of growth; each tests up to two batches.
        branches: lines that begin at the start or at the goal and are likely to lead out of a narrow place; as much of
            each as is free is grown first.
    """
    trees = [_Tree(start[None].copy()), _Tree(goal[None].copy())]
    for branch in branches:
        tree = trees[0] if np.array_equal(branch[0], start) else trees[1]
        node = np.zeros(1, int)
        for point in branch[1:]:
            node = _extend(tree, node, point[None], free, resolution, limit=np.inf)
            if len(node) == 0 or not np.array_equal(tree.nodes[node[0]], point):
                break
    for round_number in range(max_rounds):
        grown, other = round_number % 2, 1 - round_number % 2
        targets = rng.uniform(lower, upper, size=(_BRANCHES, len(start)))
        # Some samples near the line between the ends, for most detours are short, and some near the tree's own nodes,
        # for narrow places are left in small steps.
        line = start + rng.uniform(size=(_NEAR_LINE, 1)) * (goal - start)
        own = trees[grown].nodes[rng.integers(len(trees[grown].nodes), size=_NEAR_TREE)]
        centers = np.concatenate([line, own])
        scale = np.repeat([0.6, 0.3], [_NEAR_LINE, _NEAR_TREE])[:, None]
        targets[: len(centers)] = np.clip(centers + scale * rng.normal(size=centers.shape), lower, upper)
        new = _extend(trees[grown], trees[grown].nearest(targets), targets, free, resolution, limit=_EDGE)
        if len(new) == 0:
            continue
        tips = trees[grown].nodes[new]
        near_other = trees[other].nearest(tips)
        # The closest few of the new nodes try to reach the other tree all the way.
        gap = np.linalg.norm(trees[other].nodes[near_other] - tips, axis=1)
        chosen = np.argsort(gap)[:4]
        reached = _extend(trees[other], near_other[chosen], tips[chosen], free, resolution, limit=np.inf, keep=True)
        for tip, node in zip(new[chosen], reached, strict=True):
            if node >= 0 and np.array_equal(trees[other].nodes[node], trees[grown].nodes[tip]):
                a = trees[grown].branch(int(tip))
                b = trees[other].branch(int(node))
                forward, backward = trees[grown].nodes[a], trees[other].nodes[b]
                points = np.concatenate([forward[::-1], backward[1:]])
                return points if grown == 0 else points[::-1].copy()
    return None


def _extend(
    tree: _Tree,
    origins: Int[np.ndarray, " S"],
    targets: Float[np.ndarray, "S n"],
    free: Validity,
    resolution: float,
    limit: float,
    keep: bool = False,
) -> Int[np.ndarray, " _"]:
    """Grow each origin towards its target as far as the edge is free; indices of the new nodes.

    With ``keep`` the answer has one entry per target, −1 where nothing was added.
    """
    begin = tree.nodes[origins]
    span = targets - begin
    length = np.linalg.norm(span, axis=1)
    share = np.minimum(1.0, limit / np.maximum(length, 1e-12))
    ends = np.where((share < 1.0)[:, None], begin + share[:, None] * span, targets)
    fraction = _free_fraction(begin, ends, free, resolution)
    last = np.where((fraction >= 1.0)[:, None], ends, begin + fraction[:, None] * (ends - begin))
    grown = fraction > 0
    added = tree.add(origins[grown], last[grown])
    if not keep:
        return added
    out = np.full(len(origins), -1)
    out[grown] = added
    return out


def _free_fraction(
    begin: Float[np.ndarray, "S n"], end: Float[np.ndarray, "S n"], free: Validity, resolution: float
) -> Float[np.ndarray, " S"]:
    """Share of each edge, from its beginning, whose tested configurations are all free."""
    steps = np.maximum(np.ceil(np.abs(end - begin).max(axis=1) / resolution).astype(int), 1)
    owner = np.repeat(np.arange(len(begin)), steps)
    count = np.concatenate([np.arange(1, k + 1) for k in steps])
    share = (count / steps[owner])[:, None]
    ok = free(begin[owner] + share * (end[owner] - begin[owner]))
    first_hit = np.full(len(begin), np.iinfo(int).max)
    np.minimum.at(first_hit, owner[~ok], count[~ok])
    return np.minimum(first_hit - 1, steps) / steps


def shortcut(
    polyline: Float[np.ndarray, "K n"],
    free: Validity,
    rng: np.random.Generator,
    resolution: float = 0.05,
    rounds: int = 6,
) -> Float[np.ndarray, "K n"]:
    """A shorter polyline with the same ends: pieces between random pairs of points replaced by free straight lines."""
    for _ in range(rounds):
        if len(polyline) <= 2:
            break
        s = chord_lengths(polyline)
        cuts = np.sort(rng.uniform(0.0, s[-1], size=(8, 2)), axis=1)
        # Always among the candidates: the whole way, and the way past each inner corner.
        cuts = np.concatenate([[[0.0, s[-1]]], np.stack([s[:-2], s[2:]], axis=1)[:6], cuts])
        points = points_at(polyline, cuts)
        length = np.linalg.norm(points[:, 1] - points[:, 0], axis=1)
        saving = (cuts[:, 1] - cuts[:, 0]) - length
        ok = _free_fraction(points[:, 0], points[:, 1], free, resolution) >= 1.0
        saving[~ok] = 0.0
        best = int(saving.argmax())
        if saving[best] <= 1e-3:
            continue
        before, after = polyline[s < cuts[best, 0] - 1e-9], polyline[s > cuts[best, 1] + 1e-9]
        polyline = np.concatenate([before, points[best], after])
    return polyline
