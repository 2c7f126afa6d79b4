"""Which of the tried seeds make the dataset. The order of the seeds decides, not that in which workers finish."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from regrasp_datasets.records import Attempt


@dataclass(frozen=True)
class Selection:
    """The choice among the attempts so far.

    Attributes:
        seeds: seeds of the chosen episodes.
        attempts: attempts that led to them, in the order of their seeds.
        complete: whether there are enough episodes.
        need_regrasp: whether further episodes must have a regrasp.
    """

    seeds: list[int]
    attempts: list[Attempt]
    complete: bool
    need_regrasp: bool


def select(
    attempts: Mapping[int, Attempt], *, first: int, episodes: int, regrasps: int, published: Collection[int] = ()
) -> Selection:
    """Choose seeds in order from ``first``, up to the first one without an attempt.

    The choice depends only on the attempts, not on the number of workers or the order in which they finish.

    Args:
        attempts: attempts by seed.
        first: first seed.
        episodes: number of episodes wanted.
        regrasps: least number of them with a regrasp.
        published: seeds already in the dataset; they stay.
    """
    seeds: list[int] = []
    led: list[Attempt] = []
    plain = sum(attempts[seed].stages < 2 for seed in published)
    seed = first
    while (len(seeds) < episodes or len(set(published) - set(seeds)) > 0) and seed in attempts:
        attempt = attempts[seed]
        led.append(attempt)
        if seed in published:
            seeds.append(seed)
        elif attempt.saved and len(seeds) < episodes:
            if attempt.stages >= 2:
                seeds.append(seed)
            elif plain < episodes - regrasps:
                plain += 1
                seeds.append(seed)
        seed += 1
    return Selection(seeds, led, complete=len(seeds) >= episodes, need_regrasp=plain >= episodes - regrasps)
