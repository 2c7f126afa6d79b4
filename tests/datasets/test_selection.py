"""Which seeds make a dataset."""

from __future__ import annotations

import random

from hypothesis import given
from hypothesis import strategies as st

from regrasp_datasets.records import Attempt
from regrasp_datasets.selection import select

outcomes = st.lists(st.tuples(st.booleans(), st.integers(1, 3)), max_size=30)


def attempts_of(drawn, first=0):
    return {
        first + index: Attempt(first + index, "success" if saved else "plan failed", saved=saved, stages=stages)
        for index, (saved, stages) in enumerate(drawn)
    }


def by_hand(drawn, episodes, regrasps):
    """The rule, said differently: walk along, and leave out plain episodes that would take the place of a regrasp."""
    chosen: list[int] = []
    for seed, (saved, stages) in enumerate(drawn):
        plain = sum(drawn[other][1] == 1 for other in chosen)
        if saved and len(chosen) < episodes and (stages > 1 or plain + 1 <= episodes - regrasps):
            chosen.append(seed)
    return chosen


@given(outcomes, st.integers(1, 8), st.integers(0, 8))
def test_takes_the_first_that_fit(drawn, episodes, regrasps):
    regrasps = min(regrasps, episodes)
    chosen = select(attempts_of(drawn), first=0, episodes=episodes, regrasps=regrasps)
    assert chosen.seeds == by_hand(drawn, episodes, regrasps)
    assert chosen.complete == (len(chosen.seeds) == episodes)
    if chosen.complete:
        assert sum(drawn[seed][1] > 1 for seed in chosen.seeds) >= regrasps


@given(outcomes, st.integers(1, 8), st.randoms(use_true_random=False))
def test_nothing_is_decided_beyond_a_missing_seed(drawn, episodes, rng: random.Random):
    """Whatever finished early, the choice never skips a seed that is still being worked on."""
    attempts = attempts_of(drawn)
    whole = select(attempts, first=0, episodes=episodes, regrasps=0)
    kept = {seed: attempt for seed, attempt in attempts.items() if rng.random() < 0.7}
    partial = select(kept, first=0, episodes=episodes, regrasps=0)
    assert partial.seeds == whole.seeds[: len(partial.seeds)]


@given(outcomes, st.integers(1, 5), st.integers(1, 5))
def test_more_episodes_later_are_the_same_as_at_once(drawn, some, more):
    attempts = attempts_of(drawn)
    before = select(attempts, first=0, episodes=some, regrasps=0)
    after = select(attempts, first=0, episodes=some + more, regrasps=0, published=before.seeds)
    assert after.seeds == select(attempts, first=0, episodes=some + more, regrasps=0).seeds


def test_says_when_only_regrasps_are_wanted():
    attempts = attempts_of([(True, 1), (True, 1), (True, 1)])
    assert not select(attempts, first=0, episodes=5, regrasps=1).need_regrasp
    assert select(attempts, first=0, episodes=4, regrasps=2).need_regrasp


def test_published_episodes_stay_even_if_fewer_are_asked_for():
    attempts = attempts_of([(True, 1)] * 4)
    chosen = select(attempts, first=0, episodes=1, regrasps=1, published=[0, 1, 2])
    assert chosen.seeds == [0, 1, 2]
    assert chosen.complete
