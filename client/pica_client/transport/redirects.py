"""Whether we go where a relay sends us. Pure.

The address in a goodbye is a stranger's word: following it blindly, we would ask any machine that
we can reach for anything, those of our own network among them, and join there with our token. So we
go

    to a host that we were told of ourselves          any port, no path but ours
    over wss:// to another name of the same domain    its certificate says that it is

and not from ``wss://`` to ``ws://``. Of "a.example.org" the domain is "example.org"; a name without
a dot after its first part has none. Elsewhere nobody takes us: we try the addresses that we have.
"""

import ipaddress
from collections.abc import Sequence
from urllib.parse import SplitResult, urlsplit


def refused_redirect(target: str, current: str, configured: Sequence[str]) -> str:
    """Say why we do not go to an address that a relay names, or return "".

    Args:
        target: The address, as `pica_protocol.limits.check_url` lets it through.
        current: The address of the relay that names it.
        configured: The addresses that we were told of ourselves.
    """
    there, own = urlsplit(target), [urlsplit(url) for url in configured]
    if urlsplit(current).scheme == "wss" and there.scheme != "wss":
        return "connections are not encrypted there"
    paths = {"", *(each.path.rstrip("/") for each in own)}
    if there.path.rstrip("/") not in paths or there.query or there.fragment:
        return "it has a path that is not ours"
    if any(there.hostname == each.hostname for each in own):
        return ""
    if there.scheme == "wss" and any(_domain(there) == _domain(each) != "" for each in own):
        return ""
    return "it is neither a host that we were told of nor, over wss://, a name of its domain"


def _domain(url: SplitResult) -> str:
    """Return the domain that a host's name belongs to, or ""."""
    domain = (url.hostname or "").partition(".")[2]
    try:
        ipaddress.ip_address(url.hostname or "")
    except ValueError:
        return domain if "." in domain else ""
    return ""
