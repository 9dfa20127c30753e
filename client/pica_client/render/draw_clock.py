"""How long the GPU works on a frame, without waiting for it.

A timer query's answer is there when the GPU is done, and asking earlier waits for it. So queries
are taken in turn, and each is read just before its turn comes again, `DEPTH` frames later.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

import moderngl

DEPTH = 3
"""Frames between asking and reading (chosen: drivers queue two, rarely three)."""

WARM_UP_FRAMES = 3
"""The first frames of a context are not told of: drivers still compile, and llvmpipe's first query
answers with the largest number it knows."""
SATURATED_NS = 2**32 - 1
"""Answers are read as 32 bits: this, and nothing above, means that it is unknown."""

T = TypeVar("T")


class DrawClock(Generic[T]):
    """Times frames on the GPU; belongs to the thread of its context."""

    def __init__(self, context: moderngl.Context) -> None:
        self._queries = [context.query(time=True) for _ in range(DEPTH)]
        self._tags: list[T | None] = [None] * DEPTH
        self._turn = 0
        self._done: list[tuple[T, float]] = []

    @contextmanager
    def around(self, tag: T) -> Iterator[None]:
        """Time what is drawn inside; `tag` comes back with the answer."""
        place = self._turn % DEPTH
        query, before = self._queries[place], self._tags[place]
        if before is not None:
            elapsed_ns = query.elapsed
            if self._turn >= DEPTH + WARM_UP_FRAMES and 0 < elapsed_ns < SATURATED_NS:
                self._done.append((before, elapsed_ns * 1e-9))
        self._tags[place] = tag
        self._turn += 1
        with query:
            yield

    def take(self) -> list[tuple[T, float]]:
        """Frames whose time has come to be known, and how long they took, seconds."""
        done, self._done = self._done, []
        return done
