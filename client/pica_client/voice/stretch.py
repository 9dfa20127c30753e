"""A sound made a little shorter or longer, unheard (WSOLA; Verhelst and Roelands, 1993). Pure.

Speech repeats itself with its pitch. Where one period is left out, or said twice, with a cross-fade
from one place to another that looks like it, the voice is only heard to speak a little
faster or slower. In silence any two places look alike.
"""

import numpy as np

from pica_core.types import Array

MIN_LAG = 120
"""Shortest stretch, samples: 2.5 ms, the period of 400 Hz."""
MAX_LAG = 720
"""Longest: 15 ms, the period of 67 Hz."""
FADE = 240
"""Samples of a cross-fade: 5 ms, and what two places are compared over."""
MIN_LIKENESS = 0.55
"""Normalised correlation that two places of speech need to be joined (chosen: below it a join of
the shipped sentence is heard as a click or a warble)."""
NEEDED = MAX_LAG + FADE
"""Samples that must be there to look for any lag."""


def find_lag(sound: Array, *, is_quiet: bool) -> int:
    """How far from the beginning of the sound lies the place that looks most like it.

    Args:
        sound: At least `MIN_LAG` + `FADE` samples; more than `NEEDED` are not looked at.
        is_quiet: Whether any place will do: then it is the farthest.

    Returns:
        Samples, or 0 where nothing looks like the beginning.
    """
    longest = min(len(sound) - FADE, MAX_LAG)
    if longest < MIN_LAG:
        return 0
    if is_quiet:
        return longest
    scores = _likeness(sound[: longest + FADE])
    best = int(np.argmax(scores))
    return MIN_LAG + best if scores[best] >= MIN_LIKENESS else 0


def shorten(sound: Array, lag: int) -> Array:
    """The sound with `lag` samples left out at its beginning; last axis is time."""
    return _joined(sound[..., :0], sound[..., :FADE], sound[..., lag:])


def lengthen(sound: Array, lag: int) -> Array:
    """The sound with its first `lag` samples said twice; last axis is time."""
    return _joined(sound[..., :lag], sound[..., lag : lag + FADE], sound)


def crossfade(before: Array, after: Array) -> Array:
    """Go over from one sound to another of the same length."""
    share = np.linspace(0, 1, before.shape[-1], endpoint=False, dtype=before.dtype)
    faded: Array = before + share * (after - before)
    return faded


def _joined(head: Array, leaving: Array, rest: Array) -> Array:
    faded = crossfade(leaving, rest[..., :FADE])
    return np.concatenate([head, faded, rest[..., FADE:]], axis=-1)


def _likeness(sound: Array) -> Array:
    """Normalised correlation of the first `FADE` samples with those after each lag."""
    first, others = sound[:FADE], sound[MIN_LAG:]
    squares = np.concatenate([[0.0], np.cumsum(np.square(others, dtype=np.float64))])
    energies = squares[FADE:] - squares[:-FADE]
    scale = np.sqrt(np.maximum(energies * np.dot(first, first), 1e-20))
    likeness: Array = np.correlate(others, first, "valid") / scale
    return likeness
