"""Whose request it is, and for whom, as its headers tell: what proxies add, and ``Host``. Pure.

Each proxy adds the address that it was called from at the end of the header. So it is read from the
end, as far as those who wrote it are trusted; what stands before that is anybody's word. The answer
is used to count connections of one address, and for nothing else.
"""

import ipaddress
from collections.abc import Sequence
from typing import Final
from urllib.parse import urlsplit

Network = ipaddress.IPv4Network | ipaddress.IPv6Network
_Address = ipaddress.IPv4Address | ipaddress.IPv6Address
PROXY_HEADERS: Final = ("X-Forwarded-For", "Forwarded", "X-Real-IP", "Via")
"""Each tells that a proxy asks for another client (RFC 7239; the others are custom)."""
_MOST_HOPS = 64
"""Looked at in one header; no deployment has as many proxies (chosen)."""


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
