"""What all benches share: turns, times with their spread, tables, options.

Cases of a bench take turns, round after round, so that a busy machine treats all alike; the first
rounds warm up and are not counted. Results are medians.
"""

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import median, quantiles
from typing import Annotated, Any, TypeVar

from cyclopts import Parameter, Token

from pica_client.errors import OptionError
from pica_client.stats import describe_machine, percentile
from pica_client.system import say

T = TypeVar("T")
Case = TypeVar("Case")

NUM_REPORTS = 5
"""Reports of progress on stderr of one bench."""


def timed(work: Callable[..., T], *arguments: Any) -> tuple[float, T]:
    """Do some work; the seconds that it took, and its result."""
    begin_s = time.perf_counter()
    result = work(*arguments)
    return time.perf_counter() - begin_s, result


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


def times_ms(samples_s: Sequence[float]) -> dict[str, float]:
    """Median and 95th percentile in milliseconds, and the quartiles' distance over the median."""
    ordered = sorted(samples_s)
    low, middle, high = quantiles(ordered, n=4) if len(ordered) > 1 else ordered * 3
    return {
        "ms": round(median(ordered) * 1e3, 3),
        "p95": round(percentile(ordered, 95) * 1e3, 3),
        "spread": round((high - low) / middle, 3),
    }


def ratio(over_s: Sequence[float], under_s: Sequence[float]) -> float:
    """The median over rounds of two times of the same round."""
    return round(median(a / b for a, b in zip(over_s, under_s, strict=True)), 3)


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
