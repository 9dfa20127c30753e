"""What all benches share: turns, times with their spread, tables, options, GL contexts.

Cases of a bench take turns, round after round, so that a busy machine treats all alike; the first
rounds warm up and are not counted. Results are medians.
"""

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import median, quantiles
from typing import Annotated, Any, NamedTuple, TypeVar

from cyclopts import Parameter, Token

from pica_client.errors import OptionError
from pica_client.stats import describe_machine, percentile
from pica_client.system import say

T = TypeVar("T")
Case = TypeVar("Case")

NUM_REPORTS = 5
"""Reports of progress on stderr of one bench."""


class Took(NamedTuple):
    """What some work took.

    Attributes:
        wall_s: Seconds by the clock.
        cpu_s: Seconds of processor time of all threads of this process: with software GL what the
            work costs others; meaningless with a GPU.
    """

    wall_s: float
    cpu_s: float


def timed(work: Callable[..., T], *arguments: Any) -> tuple[Took, T]:
    """Do some work; what it took, and its result."""
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    result = work(*arguments)
    return Took(time.perf_counter() - wall_s, time.process_time() - cpu_s), result


def take_turns(
    cases: Sequence[Case],
    work: Callable[[Case, int], T],
    *,
    rounds: int,
    warm_up: int,
) -> list[list[T]]:
    """Let every case work once a round, every second round backwards, and report progress.

    Args:
        work: Does a case's work of a round, given its number: negative while warming up.
        warm_up: Rounds before them.

    Returns:
        The results of the rounds that count, by case.
    """
    found: list[list[T]] = [[] for _ in cases]
    for number in range(-warm_up, rounds):
        if number >= 0 and number % max(rounds // NUM_REPORTS, 1) == 0:
            say(f"round {number} of {rounds}")
        for index in range(len(cases))[:: -1 if number > 0 and number % 2 else 1]:
            result = work(cases[index], number)
            if number >= 0:
                found[index].append(result)
    return found


def times_ms(samples: Sequence[Took]) -> dict[str, float]:
    """Median, 95th percentile and processor time in milliseconds, and (upper quartile - lower
    quartile) / median."""
    walls = sorted(took.wall_s for took in samples)
    low, middle, high = quantiles(walls, n=4) if len(walls) > 1 else walls * 3
    return {
        "ms": round(median(walls) * 1e3, 3),
        "p95": round(percentile(walls, 95) * 1e3, 3),
        "cpu_ms": round(median(took.cpu_s for took in samples) * 1e3, 3),
        "spread": round((high - low) / middle, 3),
    }


def ratio(over: Sequence[Took], under: Sequence[Took]) -> float:
    """The median over rounds of two times of the same round."""
    return round(median(a.wall_s / b.wall_s for a, b in zip(over, under, strict=True)), 3)


def report(config: Any, rows: Sequence[Mapping[str, Any]], **more: Any) -> dict[str, Any]:
    """Return the result of a bench: its rows, its options, and what it was measured on.

    Args:
        config: A dataclass of plain values.
    """
    options = {
        name: str(value) if isinstance(value, Path) else value
        for name, value in asdict(config).items()
    }
    return {"rows": list(rows), **more, "options": options, "machine": describe_machine()}


def say_rows(rows: Sequence[Mapping[str, Any]], columns: str) -> None:
    """Print some fields of the rows of a result as a table.

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


def _words(_type: object, tokens: Sequence[Token]) -> tuple[str, ...]:
    return tuple(part.strip() for part in tokens[0].value.split(",") if part.strip())


Words = Annotated[
    tuple[str, ...],
    Parameter(converter=_words, n_tokens=1, metavar="NAMES", show_default=",".join),
]
"""A list as one word of the command line."""


def check_names(option: str, names: Iterable[str], known: Collection[str]) -> None:
    """Refuse names that an option does not have.

    Raises:
        OptionError: Names it, and those that are known.
    """
    for name in names:
        if name not in known:
            raise OptionError(f"{option} {name!r} is unknown; known are {', '.join(known)}")
