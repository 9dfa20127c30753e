"""The text a user writes after ``--source``, and the source it stands for.

csv:FILE[@SECONDS]                    a Live Link Face recording, starting somewhere in it
performance:NAME[#SEED][@SECONDS]     a performance that ships with the package
"""

import math
from collections.abc import Callable
from pathlib import Path

from pica_client.errors import SourceError
from pica_client.sources.livelink_csv import load_livelink_csv
from pica_client.sources.performances import PERFORMANCES, make_performance
from pica_client.sources.source import Source

SOURCE_HELP = (
    "csv:FILE[@SECONDS] for a Live Link Face recording, or "
    "performance:NAME[#SEED][@SECONDS] with NAME one of " + ", ".join(PERFORMANCES)
)


def open_source(text: str) -> Source:
    """Open the source that a text describes.

    Raises:
        SourceError: The text is not of a known form, or what it names cannot be read.
    """
    kind, _, rest = text.partition(":")
    opener = OPENERS.get(kind)
    if opener is None or not rest:
        raise SourceError(f"source {text!r} is unknown; write {SOURCE_HELP}")
    name, start_s = _split_start(rest, text)
    return opener(name, start_s)


def start_later(text: str, seconds: float) -> str:
    """The same source, begun some seconds further on."""
    rest, start_s = _split_start(text, text)
    return f"{rest}@{start_s + seconds:g}"


def _split_start(rest: str, text: str) -> tuple[str, float]:
    """Cut ``@SECONDS`` off the end, if it is there; a path may hold an @ of its own."""
    name, at, tail = rest.rpartition("@")
    if not at:
        return rest, 0.0
    try:
        start_s = float(tail)
    except ValueError:
        return rest, 0.0
    if not math.isfinite(start_s):
        raise SourceError(f"source {text!r}: the start must be a finite number of seconds")
    return name, start_s


def _open_csv(name: str, start_s: float) -> Source:
    return load_livelink_csv(Path(name).expanduser(), start_s=start_s)


def _open_performance(name: str, start_s: float) -> Source:
    name, mark, seed = name.partition("#")
    if mark and not seed.isdecimal():
        raise SourceError(f"performance seed {seed!r} is not a number; write performance:NAME#7")
    return make_performance(name, seed=int(seed) if mark else 0, start_s=start_s)


OPENERS: dict[str, Callable[[str, float], Source]] = {
    "csv": _open_csv,
    "performance": _open_performance,
}
"""Each kind of source by the word before the colon."""
