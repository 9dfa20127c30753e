"""Whose request it is, and how much each client and address may ask of a relay. Pure.

Each proxy adds the address that it was called from at the end of the header. So it is read from the
end, as far as those who wrote it are trusted; what stands before that is anybody's word. The answer
is used to count connections of one address, and for nothing else.
"""

import ipaddress
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from typing import Final
from urllib.parse import urlsplit

from pica_protocol.errors import CloseCode

MOST_REMEMBERED: Final = 4096
"""Addresses whose pace is known; one more, and the one that has been known longest begins again
(chosen: half a megabyte)."""
RESERVED: Final = 32
"""Descriptors that are for the relay's own files, and for those sockets that are told no
(chosen)."""
Network = ipaddress.IPv4Network | ipaddress.IPv6Network
_Address = ipaddress.IPv4Address | ipaddress.IPv6Address
PROXY_HEADERS: Final = ("X-Forwarded-For", "Forwarded", "X-Real-IP", "Via")
"""Each tells that a proxy asks for another client (RFC 7239; the others are custom)."""
_MOST_HOPS = 64
"""Looked at in one header; no deployment has as many proxies (chosen)."""


class RefusalError(Exception):
    """A peer may not do what it asks for; it is told ``code``, and ``limit`` is counted."""

    def __init__(self, message: str, code: CloseCode, limit: str = "admission") -> None:
        super().__init__(message)
        self.code, self.limit = code, limit


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
        self, *, handshakes: int, per_address: int, per_s: float, burst: float, most: int = 1 << 30
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


def networks(names: Sequence[str]) -> tuple[Network, ...]:
    """Return the networks of some addresses, or networks as 10.0.0.0/8.

    Raises:
        ValueError: One is neither; the text quotes it.
    """
    return tuple(ipaddress.ip_network(name) for name in names)


def client_of(peer: str, headers: Sequence[str], trusted: Sequence[Network]) -> str:
    """Return the address of the first one on the way back who is no trusted proxy; ``headers`` are
    all ``X-Forwarded-For`` of the request, in order."""
    nearest = peer
    hops = [hop for header in headers for hop in header.rsplit(",", _MOST_HOPS)]
    for hop in reversed(hops):
        address = _address(hop)
        if address is None or not is_in(nearest, trusted):
            break
        nearest = str(address)
    return nearest


def is_in(host: str, networks: Sequence[Network]) -> bool:
    """Return True if an address is in one of the networks."""
    address = _address(host)
    return address is not None and any(address in network for network in networks)


def names_this_machine(host: str) -> bool:
    """Return True if a ``Host`` header rules out DNS rebinding."""
    try:
        return is_loopback(urlsplit(f"//{host}").hostname or "")
    except ValueError:
        return False


def address_group(host: str) -> str:
    """Return what counts as one address: an IPv4 address, or the /64 of an IPv6 one.

    Empty for this machine, which is not limited: behind a proxy everybody comes from there, and
    the proxy can limit better.
    """
    address = _address(host)
    if address is None or address.is_loopback:
        return ""
    is_short = isinstance(address, ipaddress.IPv4Address)
    return str(address) if is_short else address.packed[:8].hex()


def is_loopback(host: str) -> bool:
    """Return True if only this machine reaches an address."""
    address = _address(host)
    return host == "localhost" or (address is not None and address.is_loopback)


def _address(text: str) -> _Address | None:
    """Read an address, with or without a port; None if it is none."""
    text = text.strip().strip('"').partition("%")[0]
    if text.startswith("["):
        text = text[1:].partition("]")[0]
    elif text.count(":") == 1:
        text = text.partition(":")[0]
    try:
        address = ipaddress.ip_address(text)
    except ValueError:
        return None
    mapped = getattr(address, "ipv4_mapped", None)
    return address if mapped is None else mapped
