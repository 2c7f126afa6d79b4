"""Results are kept as long as the object they belong to."""

from __future__ import annotations

import gc

import pytest

from regrasp_planner.memo import IdentityMemo


class Owner:
    pass


def test_a_result_is_made_once_for_each_owner_and_key() -> None:
    memo, owner, made = IdentityMemo(), Owner(), []

    def make() -> list[int]:
        made.append(len(made))
        return [made[-1]]

    first = memo.get(owner, make)
    assert memo.get(owner, make) is first
    assert memo.get(owner, make, key=2) is not first
    assert memo.get(Owner(), make) is not first
    assert len(made) == 3


def test_results_go_with_their_owner() -> None:
    memo = IdentityMemo()
    owner = Owner()
    memo.get(owner, Owner)
    assert len(memo._kept) == 1
    del owner
    gc.collect()
    assert not memo._kept


def test_nothing_is_kept_for_an_owner_that_cannot_be_watched() -> None:
    memo = IdentityMemo()
    with pytest.raises(TypeError, match="weak reference"):
        memo.get(1, list)
    assert not memo._kept
