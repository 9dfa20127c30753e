"""What all benches share: fair turns, times with their spread, tables, GL contexts.

Cases of a bench take turns, round after round, so that a busy machine treats all alike; the
first rounds warm up and are not counted. Results are medians with quartiles.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from statistics import median, quantiles
from typing import Any, NamedTuple, TypeVar

import moderngl
import numpy as np

from pica_client.output import say
from pica_core.gl import create_context

T = TypeVar("T")
Case = TypeVar("Case")

NUM_REPORTS = 5
"""Words of progress that a bench says on stderr."""


class Took(NamedTuple):
    """What some work took.

    Attributes:
        wall_s: Seconds by the clock.
        cpu_s: Seconds of processor time of all threads of this process: with software GL what the
            work costs whoever else runs; meaningless with a GPU.
    """

    wall_s: float
    cpu_s: float


def timed(work: Callable[..., T], *arguments: Any) -> tuple[Took, T]:
    """Do some work; what it took, and what came of it."""
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    result = work(*arguments)
    return Took(time.perf_counter() - wall_s, time.process_time() - cpu_s), result


def take_turns(
    cases: Sequence[Case],
    work: Callable[[Case, int], T],
    *,
    rounds: int,
    warm_up: int,
    seed: int | None = None,
) -> list[list[T]]:
    """Let every case work once a round, and report progress on stderr.

    Args:
        work: Does a case's work of a round, given its number: negative while warming up.
        warm_up: Rounds before them.
        seed: Of an order drawn anew for every round; without one it stays that of the cases.

    Returns:
        What came of the rounds that count, by case.
    """
    rng = None if seed is None else np.random.default_rng(seed)
    found: list[list[T]] = [[] for _ in cases]
    for number in range(-warm_up, rounds):
        if number >= 0 and number % max(rounds // NUM_REPORTS, 1) == 0:
            say(f"round {number} of {rounds}")
        count = len(cases)
        for index in range(count) if rng is None else rng.permutation(count).tolist():
            result = work(cases[index], number)
            if number >= 0:
                found[index].append(result)
    return found


def median_ms(samples_s: Sequence[float]) -> float:
    """Median of seconds, in milliseconds."""
    return round(median(samples_s) * 1e3, 3)


def spread(samples: Sequence[float]) -> float:
    """(upper quartile - lower quartile) / median."""
    if len(samples) < 2:
        return 0.0
    low, middle, high = quantiles(samples, n=4)
    return round((high - low) / middle, 3)


def say_rows(rows: Sequence[Mapping[str, Any]], columns: str) -> None:
    """Tell the user some fields of the rows of a result, as a table.

    Args:
        columns: Names of fields, with spaces between.
    """
    names = columns.split()
    lines = [names, *([_shown(row[name]) for name in names] for row in rows)]
    widths = [max(map(len, cells)) for cells in zip(*lines, strict=True)]
    for line in lines:
        say("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))


def _shown(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.5g}" if isinstance(value, float) else str(value)


@contextmanager
def gl_context() -> Iterator[moderngl.Context]:
    """A GL context for a block.

    Raises:
        GraphicsError: There is none; names the fix.
    """
    context = create_context()
    try:
        yield context
    finally:
        context.release()
