"""How much is too much: token buckets, and who holds how many sockets. Pure."""

from collections import Counter
from contextlib import suppress
from typing import Final

MOST_REMEMBERED: Final = 4096
"""Addresses whose pace is known; one more, and the one that has been known longest begins again
(chosen: half a megabyte)."""


RESERVED: Final = 32
"""Descriptors that are for the relay's own files, and for those sockets that are told no
(chosen)."""


class TokenBucket:
    """Lets through ``rate`` a second on average and ``burst`` at once."""

    __slots__ = ("_burst", "_filled_s", "_level", "_rate")

    def __init__(self, rate: float, burst: float, now: float, level: float | None = None) -> None:
        """Begin with ``level`` in it, but no more than ``burst``; full by default."""
        self._rate = rate
        self._burst = burst
        self._level = burst if level is None else min(level, burst)
        self._filled_s = now

    def take(self, now: float, amount: float = 1.0) -> bool:
        """Take ``amount`` out of the bucket, or return False and leave it as it is."""
        # Written for speed. A clock that goes back must not drain it.
        if now > self._filled_s:
            self._level += (now - self._filled_s) * self._rate
            if self._level > self._burst:
                self._level = self._burst
        self._filled_s = now
        if amount > self._level:
            return False
        self._level -= amount
        return True


class SocketGuard:
    """Counts sockets from their first byte on, when there is no websocket yet to be told why."""

    def __init__(
        self,
        *,
        handshakes: int,
        per_address: int,
        per_s: float,
        burst: float,
        most: int = 1 << 30,
    ) -> None:
        """Begin without any: ``most`` sockets at once, so many handshakes of everybody and so many
        sockets of one address; new ones of an address come at ``per_s`` on average and ``burst`` at
        once."""
        self._most, self._num_open = most, 0
        self._handshakes = handshakes
        self._per_address = per_address
        self._per_s, self._burst = per_s, burst
        self._paces: dict[str, TokenBucket] = {}
        self._num_handshaking = 0
        self._open: Counter[str] = Counter()  # bounded by the number of open sockets

    def admit(self, group: str, now: float) -> bool:
        """Return True if a new socket may stay; if so, ``opened`` or ``closed`` follows."""
        is_many = bool(group) and self._open[group] >= self._per_address
        is_full = self._num_open >= self._most or self._num_handshaking >= self._handshakes
        if is_many or is_full:
            return False
        if group and not self._pace(group, now).take(now):
            return False
        self._num_handshaking += 1
        self._num_open += 1
        if group:
            self._open[group] += 1
        return True

    def _pace(self, group: str, now: float) -> TokenBucket:
        pace = self._paces.get(group)
        if pace is None:
            if len(self._paces) >= MOST_REMEMBERED:
                del self._paces[next(iter(self._paces))]
            pace = self._paces[group] = TokenBucket(self._per_s, self._burst, now)
        return pace

    def opened(self) -> None:
        """Note that a socket has become a websocket."""
        self._num_handshaking -= 1

    def closed(self, group: str, *, was_opened: bool) -> None:
        """Note that an admitted socket is gone."""
        self._num_handshaking -= not was_opened
        self._num_open -= 1
        if group:
            self._open[group] -= 1
            if self._open[group] <= 0:
                del self._open[group]


def most_sockets() -> int:
    """Raise this process's limit of descriptors as far as it may, and return how many sockets it
    leaves."""
    try:
        import resource
    except ModuleNotFoundError:  # Windows has no such limit
        return 1 << 30
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    # Some systems say "unlimited" and mean less.
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
        soft = hard
    return (1 << 30 if soft == resource.RLIM_INFINITY else soft) - RESERVED
