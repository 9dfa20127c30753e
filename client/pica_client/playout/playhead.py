"""Which moment of a stream the display is at: follows what it should be, without leaps. Pure.

The moment that should be shown moves when the playout delay changes. Following it at once would be
seen: so the display's time runs a little faster or slower until it is there, and never backwards.
Only where that would take too long it leaps forwards.
"""

import math
from typing import NamedTuple

UNSEEN_S = 0.001
"""A display that is less far behind is not seen as such."""
FASTER, SLOWER = 0.1, 0.25
"""Shares by which display time runs faster to catch up (chosen: speech 10 % faster looks natural)
and slower to fall back: more, for frames are late meanwhile."""
LED_RATE = 1.0
"""The same where a voice leads: it has been stretched already, and says how fast time goes."""
LED_LEAP_S = 0.04
"""A display this far behind the voice that leads it leaps: lips may be 45 ms late (ITU-R
BT.1359)."""
SMOOTHING = 0.1
"""Weight of a new display interval in the mean."""
MAX_STEP_S = 0.25
"""A longer step is a pause of the display."""


class Step(NamedTuple):
    """The step from one display time to the next."""

    elapsed_s: float
    """Time that passed on our clock."""
    moved_s: float
    """How far the moment shown went on; where it leapt, how far it would have gone."""
    is_leap: bool = False


class Playhead:
    """The display's time of one stream.

    Attributes:
        position_s: The moment shown, on the stream's time line; minus infinity before the first.
        step_s: Mean time between two display times.
    """

    def __init__(self, leap_s: float) -> None:
        """A display this far behind leaps."""
        self.position_s = -math.inf
        self.step_s = 0.0
        self._leap_s = leap_s
        self._now = -math.inf

    def advance(self, now: float, target_s: float, end_s: float, *, is_led: bool = False) -> Step:
        """Go on to a display time.

        Args:
            now: Our clock.
            target_s: The moment that should be shown.
            end_s: The moment up to which the face last shown had moved: where the display stands
                still beyond it, falling back that far is not seen.
            is_led: Whether the target is what a voice says just now, rather than what is waited.
        """
        if self.position_s == -math.inf:
            self.position_s, self._now = target_s, now
            return Step(0.0, 0.0)
        elapsed_s = max(now - self._now, 0.0)
        self._now = max(now, self._now)
        if elapsed_s <= MAX_STEP_S:
            self.step_s += SMOOTHING * (elapsed_s - self.step_s)
        before_s = self.position_s
        behind_s = target_s - before_s - elapsed_s
        faster, slower = (LED_RATE, LED_RATE) if is_led else (FASTER, SLOWER)
        if behind_s > max(LED_LEAP_S if is_led else self._leap_s, UNSEEN_S):
            self.position_s = target_s
            return Step(elapsed_s, elapsed_s, is_leap=True)
        rate = min(max(behind_s, -slower * elapsed_s), faster * elapsed_s)
        position_s = before_s + elapsed_s + rate
        if end_s < position_s and target_s < position_s:
            position_s = max(target_s, min(end_s, position_s))
        self.position_s = position_s
        return Step(elapsed_s, max(position_s - before_s, 0.0))
