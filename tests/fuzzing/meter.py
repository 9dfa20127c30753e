"""Counts what came of damaged messages, and watches the time and the memory of each."""

from __future__ import annotations

import time
import tracemalloc
from collections import Counter
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


class Violation(Exception):
    """Something happened that nothing documents: a defect, in the target or in what tests it."""


class Meter:
    """What a run has seen so far.

    Attributes:
        num_damaged: Damaged messages given to anybody.
        num_whole: Good ones in between, and frames that were queued: they lead into other states.
        outcomes: What came of them: ``accepted``, or why they were refused, for each target.
        longest_s: Processor time of the slowest call, and ``longest_where``.
        largest_bytes: What the most costly call held at its worst, more than before it; and
            ``largest_where``. Zero unless memory is traced.
    """

    def __init__(self) -> None:
        self.num_damaged = 0
        self.num_whole = 0
        self.outcomes: Counter[str] = Counter()
        self.longest_s = 0.0
        self.longest_where = ""
        self.largest_bytes = 0
        self.largest_where = ""
        self.target = ""

    def note(self, outcome: str, *, is_damaged: bool = True) -> None:
        """Count what came of one message."""
        if is_damaged:
            self.num_damaged += 1
        else:
            self.num_whole += 1
        self.outcomes[f"{self.target}: {outcome}"] += 1

    def call(self, function: Callable[..., T], *args: Any, **kwargs: Any) -> T:
        """Call something that a stranger's bytes reach, and watch it."""
        is_tracing = tracemalloc.is_tracing()
        before = 0
        if is_tracing:
            tracemalloc.reset_peak()
            before, _ = tracemalloc.get_traced_memory()
        begin_s = time.thread_time()
        try:
            return function(*args, **kwargs)
        finally:
            took_s = time.thread_time() - begin_s
            if took_s > self.longest_s:
                self.longest_s, self.longest_where = took_s, self.target
            if is_tracing:
                _, peak = tracemalloc.get_traced_memory()
                if peak - before > self.largest_bytes:
                    self.largest_bytes, self.largest_where = peak - before, self.target
