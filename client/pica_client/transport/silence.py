"""When a relay that says nothing is asked whether it is there, and when another way is tried. Pure.

    heard -- QUIET_S --> ask -- patience --> look -- pause --> look … -- GIVE_UP_S --> give up
      ^                   |                   |                 |
      +---- anything comes ------------------+-----------------+

Who hears others is never asked. A relay that was only busy answers late: each time that it does so
after another way was tried, patience doubles, so a relay with too much to do is not given more.
"""

import math
from collections.abc import Callable
from typing import Final, Literal

from pica_client.transport.backoff import Backoff

QUIET_S: Final = 1.0
"""Silence after which a ping is sent (chosen: who only sends hears nothing else; one ping a second
is 0.7 kbit/s both ways together)."""
PATIENCE_S: Final = 1.5
"""Longest wait for the answer, shortened by chance to no less than half, so that not all clients of
a relay that stalls come at once (chosen: with `QUIET_S` that is 1.75 to 2.5 s of silence)."""
LONGEST_PATIENCE_S: Final = 12.0
FORGET_S: Final = 60.0
"""After this time without looking for another way, patience is as at first."""
GIVE_UP_S: Final = 14.0
"""Unanswered for so long the connection counts as lost."""

Step = Literal["wait", "ask", "look", "give up"]


class Silence:
    """Watches one connection after the other for a relay that has fallen silent.

    Attributes:
        num_looks: Other ways that were tried since the relay was heard last.
    """

    def __init__(self, random: Callable[[], float]) -> None:
        """Begin; `random` gives numbers in [0, 1)."""
        self._random = random
        self._num_false = 0
        self._ended_s = -math.inf
        self.begin()

    def begin(self) -> None:
        """Note that another connection is watched from now on."""
        self.num_looks = 0
        self._asked_s, self._heard_s, self._look_s = math.inf, math.inf, math.inf
        self._pauses = Backoff(self._random)

    def next_timer(self, heard_s: float) -> float:
        """Return when `handle_timer` is due, if nothing is heard meanwhile."""
        if heard_s != self._heard_s:
            return heard_s + QUIET_S
        return min(self._look_s, self._asked_s + GIVE_UP_S)

    def handle_timer(self, heard_s: float, now: float) -> Step:
        """Say what is to be done at `now` when the relay was last heard at `heard_s`."""
        if heard_s != self._heard_s:
            if self.num_looks:
                self._num_false += 1
                self._ended_s = now
                self.begin()
            if now < heard_s + QUIET_S:
                return "wait"
            if now >= self._ended_s + FORGET_S:
                self._num_false = 0
            patience_s = min(PATIENCE_S * 2.0**self._num_false, LONGEST_PATIENCE_S)
            self._asked_s, self._heard_s = now, heard_s
            self._look_s = now + patience_s * (0.5 + 0.5 * self._random())
            return "ask"
        if now >= self._asked_s + GIVE_UP_S:
            return "give up"
        if now < self._look_s:
            return "wait"
        self.num_looks += 1
        return "look"

    def note_failed(self, now: float) -> None:
        """Note that a look for another way has found none."""
        self._look_s = now + self._pauses.next_wait_s(0.0)
