"""Who of several speaks most, from the levels of their voices. Pure.

Volfin and Cohen, "Dominant speaker identification for multipoint videoconferencing", IEEEI 2012:
activity over three spans of time, each counted in parts of the one before. A cough fills the
shortest alone and wins nothing; who takes over a conversation fills the longest within a second.
"""

import math
from collections import deque

MEDIUM, LONG = 5, 10
"""Frames of 20 ms in a medium count, and medium counts in a long one."""
IMMEDIATE_LEVELS = 13
"""Steps that a level is counted in (paper: sub-bands)."""
SPANS = (
    # counts in it, above which it is active, weight of activity, threshold of the ratio
    (IMMEDIATE_LEVELS, 3, 0.78, 3.0),
    (MEDIUM, 2, 24.0, 2.0),
    (LONG, 4, 47.0, 0.0),
)
"""The three spans; weights and thresholds are the paper's."""
SOFTEST = 80
"""Levels softer than -80 dB of full scale count nothing."""


class VoiceActivity:
    """How active one voice is, over three spans.

    Attributes:
        scores: Log likelihoods of speech, immediate, medium and long.
    """

    def __init__(self) -> None:
        self.scores = tuple(_score(0, size, weight) for size, _, weight, _ in SPANS)
        self._immediate: deque[bool] = deque(maxlen=MEDIUM)
        self._medium: deque[bool] = deque(maxlen=LONG)
        self._num_frames = 0

    def add(self, level: int) -> None:
        """Take the level of the next 20 ms: decibels below full scale, 0 to 127."""
        loud = max(SOFTEST - level, 0) * IMMEDIATE_LEVELS // SOFTEST
        loud = max(loud * 2 - IMMEDIATE_LEVELS, 0)  # -40 dB is where speech begins
        self._immediate.append(loud > SPANS[0][1])
        self._num_frames += 1
        if self._num_frames % MEDIUM == 0:
            self._medium.append(sum(self._immediate) > SPANS[1][1])
        counts = (loud, sum(self._immediate), sum(self._medium))
        self.scores = tuple(
            _score(min(count, size), size, weight)
            for count, (size, _, weight, _) in zip(counts, SPANS, strict=True)
        )


def dominant(voices: dict[str, VoiceActivity], current: str | None) -> str | None:
    """Who speaks most now; stays with the current one until somebody clearly takes over."""
    if current not in voices:
        return max(voices, key=lambda who: voices[who].scores[2], default=None)
    now = voices[current].scores
    best, best_ratio = current, 0.0
    for who, voice in voices.items():
        ratios = [mine - theirs for mine, theirs in zip(voice.scores, now, strict=True)]
        takes_over = all(r > span[3] for r, span in zip(ratios, SPANS, strict=True))
        if who != current and takes_over and ratios[1] > best_ratio:
            best, best_ratio = who, ratios[1]
    return best


def _score(count: int, size: int, weight: float) -> float:
    """The log of the likelihood of speech over that of none (paper, equations 6 to 8)."""
    ways = math.lgamma(size + 1) - math.lgamma(count + 1) - math.lgamma(size - count + 1)
    return ways + size * math.log(0.5) - math.log(weight) + weight * count
