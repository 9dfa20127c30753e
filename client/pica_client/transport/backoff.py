"""How long to wait before trying a relay again. Pure: chance is an argument."""

from collections.abc import Callable
from typing import Final

FIRST_S: Final = 0.25
"""Before the first new try (chosen: a relay that restarts is back within a second)."""
LONGEST_S: Final = 8.0
"""However long the relay is away, it is found again within this time of its return."""
SETTLED_S: Final = 5.0
"""A connection that lasted this long was a good one: the next trouble starts from `FIRST_S`."""


class Backoff:
    """Waiting times that double up to a bound, each shortened by chance.

    Chance spreads the return of a full room over time: half to all of the nominal wait.
    """

    def __init__(self, random: Callable[[], float]) -> None:
        """Start fresh; `random` gives numbers in [0, 1)."""
        self._random = random
        self._nominal_s = FIRST_S

    def next_wait_s(self, lasted_s: float) -> float:
        """Seconds to wait now, after a connection that stood for ``lasted_s``; 0: there was
        none."""
        if lasted_s >= SETTLED_S:
            self._nominal_s = FIRST_S
        wait_s = self._nominal_s * (0.5 + 0.5 * self._random())
        self._nominal_s = min(2 * self._nominal_s, LONGEST_S)
        return wait_s
