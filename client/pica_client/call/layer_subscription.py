"""How much of a stream the relay is told that we want, and when. Pure.

    subscribe(every, now)    what is wanted from now on, see `pica_protocol.messages.Subscribe`
    due(now)                 the share to tell the relay now, if any
    note_told(share, now)    the relay was told
    next_timer()             when something is due
    begin(now)               a new connection: the relay sends everything again

Up at once, down late: more is asked for as soon as it is wanted, less when nothing more has been
wanted for some time. So a head that comes and goes at the edge of the screen costs a message or two
a second at most, and its stream is there whenever it is seen.
"""

import math
from typing import Final

from pica_protocol.messages import SHARES

EVERY: Final = (0, 4, 2, 1)
"""What is asked for by *share*, which is a place in this list: the more, the higher."""
assert set(EVERY) == set(SHARES)
NOTHING: Final = 0
ALL: Final = len(EVERY) - 1
"""The share of nothing and of everything."""
LOWER_AFTER_S: Final = 0.5
"""Less is asked for when nothing more was wanted for so long (chosen: longer than a glance
aside)."""
LOWER_INTERVAL_S: Final = 1.0
"""Shortest time between two requests for less of one stream."""


class LayerSubscription:
    """What is wanted of one stream.

    Attributes:
        told: The share that the relay sends, as far as it was told.
    """

    def __init__(self) -> None:
        self.told = self._wanted = ALL  # a relay that was told nothing sends everything
        self._lower_s = math.inf  # when less is asked for
        self._highest = NOTHING  # most that was wanted since the first request for less
        self._lowered_s = -math.inf

    def subscribe(self, every: int, now: float) -> bool:
        """Note what is wanted; return whether `due` or
        `next_timer` may say something new."""
        wanted = EVERY.index(every)
        if wanted == self._wanted:
            return False
        self._wanted = wanted
        if wanted >= self.told:
            self._lower_s = math.inf
        elif self._lower_s < math.inf:
            self._highest = max(self._highest, wanted)
        else:
            self._lower(now)
        return True

    def due(self, now: float) -> int | None:
        """The share that the relay is to be told by now, `NOTHING` included; None if there is no
        news."""
        if self._wanted > self.told:
            return self._wanted
        return self._highest if now >= self._lower_s else None

    def note_told(self, share: int, now: float) -> None:
        """Note that the relay was told what was due."""
        if share < self.told:
            self._lowered_s, self._lower_s = now, math.inf
        self.told = share
        if self._wanted < share:
            self._lower(now)

    def next_timer(self) -> float | None:
        """When less may be asked for; more is due at once."""
        return self._lower_s if self._lower_s < math.inf else None

    def begin(self, now: float) -> None:
        """Begin a connection: the relay knows of no subscription, so less is due now."""
        self.told = ALL
        self._highest = self._wanted
        self._lower_s = now if self._wanted < ALL else math.inf

    def _lower(self, now: float) -> None:
        """Begin to wait until less may be asked for."""
        self._highest = self._wanted
        self._lower_s = max(now + LOWER_AFTER_S, self._lowered_s + LOWER_INTERVAL_S)
