"""How much may be on its way to one peer, so that little waits in front of its line. Pure.

TCP fills whatever buffers a slow line has, 0.8 s at 160 kbit/s with 16 KiB, and what waits there
can be neither replaced nor withdrawn. So where bytes take `QUEUE_S` longer than the fastest round
trip, only as many may be on their way as would have been in time; then an eighth more each round
trip (after Vegas: Brakmo and Peterson 1995).
"""

from collections import deque
from typing import Final

QUEUE_S: Final = 0.15
"""How long bytes may wait on their way (chosen: answers alone are delayed by 40 ms)."""
LEAST_BYTES: Final = 960
"""May always be on their way (chosen: two messages to a slow receiver)."""


class Line:
    """What is on its way to one peer."""

    def __init__(self) -> None:
        self._most_bytes, self._acked = float("inf"), 0
        # When so many bytes had been given, and how many of them were on their way.
        self._given: deque[tuple[float, int, int]] = deque()

    def is_full(self, acked: int, given: int, fastest_s: float, now: float) -> bool:
        """Return True if nothing more should be sent: how many bytes the peer has acknowledged, how
        many the kernel was given, and the fastest round trip."""
        while self._given and self._given[0][1] <= acked:
            self._given.popleft()
        if given > (self._given[-1][1] if self._given else acked):
            self._given.append((now, given, given - acked))
        in_time_s = fastest_s + QUEUE_S
        if self._given and (took_s := now - self._given[0][0]) > in_time_s:
            self._most_bytes = max(self._given[0][2] * in_time_s / took_s, LEAST_BYTES)
        else:
            self._most_bytes += (acked - self._acked) / 8
        self._acked = acked
        return given - acked > self._most_bytes
