"""How many transfers go on at once, and how fast all of them go. Pure: times are arguments."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from pica_server.errors import BusyError

LEAD_S: Final = 0.002
"""So much too early a piece may go: event loops wait in whole milliseconds."""
TOLERANCE_S: Final = 0.002
"""So late a wait ends on a loop that has nothing to do."""
REST_FACTOR: Final = 4.0
LONGEST_REST_S: Final = 0.05
"""Chosen: with it, twenty at once still get files of 2.5 MB in half the time they may take."""


class Slots:
    """Counts what goes on at the same time, in all and for each address."""

    def __init__(self, limit: int, per_address: int) -> None:
        self._limit = limit
        self._per_address = per_address
        self._by_address: Counter[str] = Counter()  # bounded by the limit

    @contextmanager
    def taken(self, address: str) -> Iterator[None]:
        """Hold one; an empty address has no limit of its own.

        Raises:
            BusyError: There is none.
        """
        is_many = bool(address) and self._by_address[address] >= self._per_address
        if is_many or self._by_address.total() >= self._limit:
            raise BusyError("too many at once, try again")
        self._by_address[address] += 1
        try:
            yield
        finally:
            self._by_address[address] -= 1
            self._by_address += Counter()  # drops those that hold none


class Pace:
    """Says how long to wait so that a rate is kept, whoever asks, and less on a busy loop."""

    def __init__(self, bytes_per_s: float) -> None:
        self._bytes_per_s = bytes_per_s
        self._free_s = 0.0

    def wait_s(self, num_bytes: int, now: float) -> float:
        """Return how long to wait before so many bytes go."""
        begin_s = max(self._free_s, now)
        self._free_s = begin_s + num_bytes / self._bytes_per_s
        return max(begin_s - now - LEAD_S, 0.0)

    def note_lateness(self, late_s: float, now: float) -> None:
        """Take note how late a wait has ended: what is late then, are the faces.

        All transfers rest for a multiple of it, so that they take a small part of a loop that has
        much to do, but never stop.
        """
        if late_s > TOLERANCE_S:
            self._free_s = max(self._free_s, now + min(REST_FACTOR * late_s, LONGEST_REST_S))
