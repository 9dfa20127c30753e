"""What a relay gives up when it has more to do than it can: upper layers, and newcomers. Pure.

Behind a loop that turns slowly everything grows old, and who reads slowly gets more at once, which
makes the next turn slower still. So what is asked of the relay must shrink:

    level    frames that are forwarded          who joins anew
    0        all                                is let in
    1        layers 0 and 1                     is told to come later
    2        layer 0                            is told to come later
    3        keyframes, asked for now and then  is told to come later

The level rises by one with a late turn after one that was hardly later: a pause is no overload, and
what gets better needs no more; to 3, which hurts, only when it was very late. It falls by one when
nothing was late for a while; each time that proves too soon, the while doubles. A loop with time to
spare need not wait as long.

Before any of that, a core that is busy saves what messages cost: the faces of a room gather for a
few milliseconds, and leave together.
"""

import math
from typing import Final

from pica_protocol.limits import MAX_LAYER

LATE_S: Final = 0.1
"""A turn of the event loop that takes longer is late (chosen: three frames of a face)."""
BETTER: Final = 0.8
"""A turn that is late by less than this part of the one before gets better (chosen)."""
CALM_S: Final = 5.0
LONGEST_CALM_S: Final = 60.0
"""Without a late turn until the level falls: at first, and at most (chosen)."""
SPARE_CALM_S: Final = 1.0
SPARE_BUSY_RATIO: Final = 0.5
"""The same while the loop works for less than this part of the time (chosen: layer 0 and 1 are half
of a stream, so twice as much will fit)."""
FULL_BUSY_RATIO: Final = 0.95
AMPLE_BUSY_RATIO: Final = 0.75
"""A loop that works for the first part of the time is full, until it works for less than the second
(chosen: where faces shared messages with voices, 0.88 of a core became 0.74)."""
FULL_LATE_S: Final = 0.02
"""A turn that is so late says so, too: others may have the core (chosen: half a packet of a
voice)."""
GATHER_S: Final = 0.025
"""How long the faces of a room gather at most (measured: 0.02 s saves a quarter of the time, this a
third; chosen to be less than what lies between two pictures of a face)."""
GATHER_BUSY_RATIO: Final = 0.6
GATHER_SPARE_RATIO: Final = 0.4
"""Faces gather once a loop works for the first part of the time, until it works for less than the
second (measured: 0.8 of a core becomes 0.55, and 0.7 0.5). Not because it is late: where others
have the core, gathering saves next to nothing."""
GATHER_SURE_S: Final = 0.5
"""It must have been so for that long (chosen: two measurements)."""
_HIGHEST_LAYERS: Final = (MAX_LAYER, 1, 0, -1)
_LATE_ENOUGH_S: Final = (LATE_S, LATE_S, 5 * LATE_S)
"""How late a turn must be for the step up from each level."""


class Brake:
    """How hard a relay brakes.

    Attributes:
        is_full: Whether the core has hardly a moment left, or the loop was late: what saves
            processor time is worth a delay.
        is_gathering: Whether the faces of a room wait for each other, `GATHER_S` at most.
        retry_after_s: When who is told to come later should.
        highest_layer: Of frames that are forwarded; -1: keyframes alone are.
    """

    def __init__(self) -> None:
        self.level = 0
        self.is_full = False
        self.highest_layer = MAX_LAYER
        self.is_gathering = False
        self._gather_differs_s = math.inf
        self._late_s = 0.0
        self._has_fallen = False
        self.retry_after_s = CALM_S
        self._late_at_s = float("-inf")
        self._changed_s = float("-inf")

    def note_turn(self, late_s: float, busy_ratio: float, now: float) -> None:
        """Note how late the loop has just been, and how much of the time it works."""
        before_s, self._late_s = self._late_s, late_s
        full_ratio = AMPLE_BUSY_RATIO if self.is_full else FULL_BUSY_RATIO
        self.is_full = late_s >= FULL_LATE_S or busy_ratio >= full_ratio or self.level > 0
        self._note_busy(busy_ratio, now)
        if late_s >= LATE_S:
            self._late_at_s = now
            is_no_better = late_s >= BETTER * before_s and before_s >= LATE_S
            late_enough_s = (*_LATE_ENOUGH_S, math.inf)[self.level]
            if is_no_better and late_s >= late_enough_s:
                if self._has_fallen and now - self._changed_s < self.retry_after_s:
                    self.retry_after_s = min(2 * self.retry_after_s, LONGEST_CALM_S)
                self._set(self.level + 1, now)
            return
        calm_s = SPARE_CALM_S if busy_ratio < SPARE_BUSY_RATIO else self.retry_after_s
        if self.level and now - max(self._late_at_s, self._changed_s) >= calm_s:
            self._set(self.level - 1, now)
        elif not self.level and now - self._late_at_s >= LONGEST_CALM_S:
            self.retry_after_s = CALM_S

    def _note_busy(self, busy_ratio: float, now: float) -> None:
        """Let faces gather, or no more, once that has been better for a while."""
        ratio = GATHER_SPARE_RATIO if self.is_gathering else GATHER_BUSY_RATIO
        if (busy_ratio >= ratio) == self.is_gathering:
            self._gather_differs_s = math.inf
            return
        self._gather_differs_s = min(self._gather_differs_s, now)
        if now - self._gather_differs_s >= GATHER_SURE_S:
            self.is_gathering, self._gather_differs_s = not self.is_gathering, math.inf

    def _set(self, level: int, now: float) -> None:
        self._has_fallen = level < self.level
        self.level, self._changed_s = level, now
        self.highest_layer = _HIGHEST_LAYERS[level]
