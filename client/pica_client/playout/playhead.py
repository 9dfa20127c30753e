"""Which moment of a stream the display is at: follows what it should be, without leaps. Pure.

The moment that should be shown moves when the playout delay changes. Following it at once would be
seen: so the display's time runs a little faster or slower until it is there, and never backwards.
Only where that would take too long it leaps forwards.
"""

import math
from typing import NamedTuple

from pica_client.playout.config import PlayoutConfig

UNSEEN_S = 0.001
"""A display that is less far behind is not seen as such."""
LED_RATE = 1.0
"""By which share time may run faster or slower where a voice leads: the voice has been stretched
already, and says how fast time goes."""
LED_LEAP_S = 0.04
"""A display this far behind the voice that leads it leaps: lips may be 45 ms late (ITU-R
BT.1359)."""


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
        num_leaps: How often the display leapt forwards.
    """

    def __init__(self, config: PlayoutConfig) -> None:
        self.position_s = -math.inf
        self.num_leaps = 0
        self._config = config
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
        before_s = self.position_s
        behind_s = target_s - before_s - elapsed_s
        config = self._config
        faster, slower, leap_s = config.faster, config.slower, config.leap_s
        if is_led:
            faster, slower, leap_s = LED_RATE, LED_RATE, LED_LEAP_S
        if behind_s > max(leap_s, UNSEEN_S):
            self.num_leaps += 1
            self.position_s = target_s
            return Step(elapsed_s, elapsed_s, is_leap=True)
        rate = min(max(behind_s, -slower * elapsed_s), faster * elapsed_s)
        position_s = before_s + elapsed_s + rate
        if end_s < position_s and target_s < position_s:
            position_s = max(target_s, min(end_s, position_s))
        self.position_s = position_s
        return Step(elapsed_s, max(position_s - before_s, 0.0))
