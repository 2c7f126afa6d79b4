"""Which of the tried seeds make the dataset: decided in the order of the seeds, whichever worker finishes first."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from regrasp_datasets.records import Attempt


@dataclass(frozen=True)
class Selection:
    """The choice among the attempts made so far.

    Attributes:
        seeds: seeds of the chosen episodes.
        attempts: attempts that led to them, in the order of their seeds.
        complete: whether nothing is missing.
        need_regrasp: whether only episodes with a regrasp are still wanted.
    """

    seeds: list[int]
    attempts: list[Attempt]
    complete: bool
    need_regrasp: bool


def select(
    attempts: Mapping[int, Attempt], *, first: int, episodes: int, regrasps: int, published: Collection[int] = ()
) -> Selection:
    """Go through the seeds from ``first`` on, as far as there is an attempt for each, and take what is wanted.

    The outcome is a function of the seeds' outcomes alone: neither the number of workers nor the order in which they
    finish changes the dataset.

    Args:
        attempts: by seed.
        first: first seed.
        episodes: how many episodes are wanted.
        regrasps: how many of them at least must hold a regrasp.
        published: seeds that are in the dataset already, and stay.
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
