"""Results kept by the identity of the object they were made from, and dropped with it."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Hashable
from typing import Any


class IdentityMemo:
    """Results of an expensive function of an object that cannot be hashed by value, such as one that holds arrays.

    The object has to be immutable: a result is made once and given again as long as the object lives.
    """

    def __init__(self) -> None:
        self._kept: dict[tuple[int, Hashable], Any] = {}

    def get[T](self, owner: object, make: Callable[[], T], key: Hashable = None) -> T:
        """The result for ``owner`` and ``key``: a kept one, or that of ``make()``.

        Args:
            owner: what the result belongs to; it is dropped when the owner is.
            make: makes the result.
            key: tells several results of one owner apart.
        """
        where = (id(owner), key)
        if where not in self._kept:
            result = make()
            # First, so that nothing is kept for an owner that cannot be watched.
            weakref.finalize(owner, self._kept.pop, where, None)
            self._kept[where] = result
        return self._kept[where]
