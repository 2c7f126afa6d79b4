"""Wall-clock time by module."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager


class Clock:
    """Adds up the wall-clock time spent in each module: ``with clock("path_plan"): …``.

    Attributes:
        seconds: by module.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, module: str) -> Generator[None]:
        """Count the time inside the block."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[module] = self.seconds.get(module, 0.0) + time.perf_counter() - began

    def each[T](self, module: str, items: Iterator[T]) -> Iterator[T]:
        """The same items; the time to produce each is counted."""
        while True:
            with self(module):
                try:
                    item = next(items)
                except StopIteration:
                    return
            yield item
