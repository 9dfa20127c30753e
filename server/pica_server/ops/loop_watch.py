"""Whether the event loop keeps up: how late its timers fire. Pure."""

from collections import deque
from typing import Final

PERIOD_S: Final = 0.05
"""Between two looks (chosen: half of what is late, see `room.brake`)."""
REMEMBERED_S: Final = 10.0
"""How long a stall counts (chosen: a health check each ten seconds sees every stall)."""
WORST_S: Final = 1.0
"""A timer later than this means that everybody's face froze for a second."""


class LoopWatch:
    """Remembers the latest delays of a timer that is set every ``PERIOD_S``."""

    def __init__(self) -> None:
        self._lateness: deque[tuple[float, float]] = deque(maxlen=round(REMEMBERED_S / PERIOD_S))

    def note(self, due_s: float, now: float) -> None:
        """Note when a timer fired that was due at ``due_s``."""
        self._lateness.append((now, now - due_s))

    def worst_s(self, now: float) -> float:
        """Return the worst delay that is remembered."""
        recent = (late for at, late in self._lateness if now - at <= REMEMBERED_S)
        return max(recent, default=0.0)
