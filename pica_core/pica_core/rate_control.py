"""Keep a latent stream at a bitrate, by choosing each frame's quality. Pure: `now_s` is an
argument.

A window holds what was sent during the last second. Before every base frame the quality moves
towards where the window would hold the target; a window that is full already refuses upper layers,
and a quality that is the lowest already leaves nothing else to give.
"""

from __future__ import annotations

import math
from collections import deque

WINDOW_S = 1.0
BITS_PER_QUALITY = 1.3
"""What one quality costs against the next, roughly (measured: docs/results/codec.jsonl)."""
EAGERNESS = 0.35
"""Share of the way to the right quality that is gone at once; the bitrate of a face jumps about,
and a quality that follows every jump flickers."""
MAX_FRAMES = 1000
"""Frames remembered; more in a second than any sender sends."""


class RateController:
    """Chooses qualities.

    Args:
        target_bps: Payload bits a second to keep to.
        num_qualities: How many there are; the last is the finest.
        start: Quality to begin with.
    """

    def __init__(self, target_bps: float, num_qualities: int, start: int) -> None:
        if not target_bps > 0:
            raise ValueError(f"target_bps is {target_bps}; it must be above 0")
        self._target_bits = target_bps * WINDOW_S
        self._highest = num_qualities - 1
        self._level = float(start)
        # Drops its oldest when full.
        self._sent: deque[tuple[float, int]] = deque(maxlen=MAX_FRAMES)
        self._begin_s: float | None = None

    def window_bits(self, now_s: float) -> int:
        """Bits sent during the last second."""
        while self._sent and self._sent[0][0] <= now_s - WINDOW_S:
            self._sent.popleft()
        return sum(bits for _, bits in self._sent)

    def choose(self, now_s: float) -> int:
        """Move towards the target; the quality for the next base frame and those above it."""
        bits = self.window_bits(now_s)
        if self._begin_s is not None and bits:
            # Until a second has passed, what was sent stands for its share of one.
            share = min(max((now_s - self._begin_s) / WINDOW_S, 0.1), 1.0)
            ratio = self._target_bits * share / bits
            self._level += EAGERNESS * math.log(ratio) / math.log(BITS_PER_QUALITY)
        self._level = min(max(self._level, 0.0), float(self._highest))
        return self.quality

    @property
    def quality(self) -> int:
        """The quality chosen last."""
        return round(self._level)

    def has_room(self, now_s: float) -> bool:
        """Whether the window has room for a frame that could be left out."""
        return self.window_bits(now_s) < self._target_bits

    def sent(self, num_bytes: int, now_s: float) -> None:
        """Take note of a frame."""
        self._begin_s = now_s if self._begin_s is None else self._begin_s
        self._sent.append((now_s, 8 * num_bytes))
