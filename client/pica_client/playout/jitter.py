"""How long frames of a stream must be waited for: fast up, slow down. Pure.

The lateness of a frame is how far its transit lies above the fastest (`clock_map`). What counts are
delays, not frames: those that a stall held back come in one burst, and only the first of them tells
how long it was. (Counting all of them let one stall of 300 ms every two seconds raise the delay
to its ceiling; the face was 150 ms older and hardly less often concealed.) Two windows rate, and
the longer wait counts:

- slow release: the share of the delays of the last seconds that must not be longer. When trouble
  ends it is forgotten after one such window;
- fast attack: the same of the last second alone, so that three delays are enough.

What *all* frames of the long window have in common is no jitter but the way itself (a longer route,
a standing queue, a sender's clock set back): `base_s`, which is waited for without being counted.
"""

import math

import numpy as np

from pica_client.playout.clock_map import ClockMap
from pica_core.types import Float64Array

ATTACK_WINDOW_S = 1.0
"""Length of the short window (chosen: of the usual stream three delays are enough)."""
ATTACK_QUANTILE = 0.9
"""Share of the short window that is waited for."""
ATTACK_MIN_DELAYS = 10
"""Fewer in the short window say nothing about such a share."""
CAPACITY = 2048
"""Frames a window holds; drops its oldest beyond (chosen: 6 s at 240 fps and some)."""


class JitterEstimate:
    """How late the frames of one stream are.

    Attributes:
        base_s: Lateness that every recent frame had.
        jitter_s: Lateness above it that should be waited for.
    """

    def __init__(self, *, quantile: float, window_s: float) -> None:
        self.base_s = self.jitter_s = 0.0
        self._quantile = quantile
        self._all, self._release = _Window(window_s), _Window(window_s)
        self._attack = _Window(ATTACK_WINDOW_S)
        self._last = (-math.inf, -math.inf)  # (arrived_s, media_s)

    def receive(self, arrived_s: float, media_s: float, clock: ClockMap) -> None:
        """Let a frame move the clock map, and take into account how late it then is."""
        transit_s = clock.receive(media_s, arrived_s)
        last_arrived_s, last_media_s = self._last
        is_burst = arrived_s - last_arrived_s < 0.5 * (media_s - last_media_s)
        self._last = (arrived_s, media_s)
        self._all.add(arrived_s, media_s, transit_s)
        self.base_s = float(self._all.lateness_s(clock).min())
        if not (is_burst and self._release.num_rows):
            self._release.add(arrived_s, media_s, transit_s)
            self._attack.add(arrived_s, media_s, transit_s)
        wait_s = _quantile(self._release.lateness_s(clock), self._quantile)
        if self._attack.num_rows >= ATTACK_MIN_DELAYS:
            wait_s = max(wait_s, _quantile(self._attack.lateness_s(clock), ATTACK_QUANTILE))
        self.jitter_s = max(wait_s - self.base_s, 0.0)


class _Window:
    """What arrived in the last seconds, in one flat array that is moved to its front when full."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._rows = np.empty((2 * CAPACITY, 3))  # arrived_s, media_s, transit_s
        self._begin = self._end = 0

    @property
    def num_rows(self) -> int:
        return self._end - self._begin

    def add(self, arrived_s: float, media_s: float, transit_s: float) -> None:
        if self._end == len(self._rows):
            kept = self._rows[self._begin :].copy()
            self._begin, self._end = 0, len(kept)
            self._rows[: len(kept)] = kept
        self._rows[self._end] = arrived_s, media_s, transit_s
        self._end += 1
        self._begin = max(self._begin, self._end - CAPACITY)
        while self._rows[self._begin, 0] < arrived_s - self._seconds:  # the newest ends it
            self._begin += 1

    def lateness_s(self, clock: ClockMap) -> Float64Array:
        rows = self._rows[self._begin : self._end]
        # The map is a line: two of its points give it everywhere.
        at_zero_s = clock.fastest_transit_s(0.0)
        slope = clock.fastest_transit_s(1.0) - at_zero_s
        lateness: Float64Array = rows[:, 2] - at_zero_s - slope * rows[:, 1]
        return lateness


def _quantile(values: Float64Array, share: float) -> float:
    """The least value that this share of the values does not exceed."""
    rank = math.ceil(share * len(values)) - 1
    return float(np.partition(values, rank)[rank])
