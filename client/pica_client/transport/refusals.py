"""What it means that a relay refuses us, or sends us to another one. Pure.

A refusal that waiting cannot mend is final. The rest may pass (`pica_protocol.errors.may_pass`): an
older connection of ours still holds the place, a key file or a clock is being corrected. At the
first join these end the link at once all the same; later it tries again for `RETURN_S`.

The address in a goodbye is not to be trusted: following it blindly, we would contact any machine
that we can reach, those of our own network among them, and join there with our token. So we follow

    to a host of our configuration                    any port, no path but ours
    over wss:// to another name of the same domain    its certificate proves that it is

and not from ``wss://`` to ``ws://``. Of "a.example.org" the domain is "example.org"; a name without
a dot after its first part has none.
"""

import ipaddress
import logging
from typing import Final
from urllib.parse import SplitResult, urlsplit

from pica_client.errors import OptionError, RelayRefusedError
from pica_client.transport.config import LinkConfig
from pica_protocol.errors import CloseCode, is_worth_retrying, may_pass
from pica_protocol.session import Closed

_log = logging.getLogger(__name__)

RETURN_S: Final = 60.0
"""So long a link that was in the room is refused before that is final (chosen: old connections end
after 20 s, and a clock or a key file is corrected within a minute or not by itself)."""


def breaks_protocol(closed: Closed) -> bool:
    """Return True if a connection ended because one end broke the protocol."""
    return closed.code in (CloseCode.MALFORMED, CloseCode.UNEXPECTED_MESSAGE)


def refusal_of(url: str, closed: Closed) -> RelayRefusedError | None:
    """Return what it means that a relay closed a connection, or None: come back at once."""
    # What we could not read may have been a passing fault of the relay: try again, slower.
    if is_worth_retrying(closed.code) or (breaks_protocol(closed) and not closed.is_remote):
        return None
    return RelayRefusedError(
        f"{url}: the relay said no: {closed.reason or 'no reason'} (code {closed.code})",
        may_pass=may_pass(closed.code),
        code=closed.code,
    )


class Refusals:
    """Remembers whether we were in the room, and since when we are refused."""

    def __init__(self) -> None:
        self._was_in = False
        self._since_s: float | None = None

    def note_joined(self) -> None:
        """Note that we are in."""
        self._was_in, self._since_s = True, None

    def receive(self, error: RelayRefusedError | OptionError, now: float) -> None:
        """Take a refusal, or the trouble with our own token file, and raise it if it is the end."""
        is_final = isinstance(error, RelayRefusedError) and not error.may_pass
        if is_final or not self._was_in:
            raise error
        if self._since_s is None:
            self._since_s = now
        if now - self._since_s >= RETURN_S:
            raise type(error)(f"{error}; tried to come back for {RETURN_S:g} s") from error


def redirect_of(closed: Closed | None, current: str, config: LinkConfig) -> str:
    """Return the other relay that a connection ended with, if we may go there, or ""."""
    if closed is None or closed.code != CloseCode.GOING_AWAY or not closed.url:
        return ""
    refused = refused_redirect(closed.url, current, config)
    if refused:
        _log.warning("the relay redirects us; not following: %s", refused)
    return "" if refused else closed.url


def refused_redirect(target: str, current: str, config: LinkConfig) -> str:
    """Return why we do not follow a redirect, or "".

    Args:
        target: The address, as `pica_protocol.limits.check_url` lets it through.
        current: The address of the relay that names it.
    """
    there, own = urlsplit(target), urlsplit(config.url)
    if urlsplit(current).scheme == "wss" and there.scheme != "wss":
        return "connections are not encrypted there"
    if there.path.rstrip("/") not in ("", own.path.rstrip("/")) or there.query or there.fragment:
        return "it has a path that is not ours"
    if there.hostname in (own.hostname, *map(str.lower, config.redirect_hosts)):
        return ""
    if there.scheme == "wss" and _domain(there) == _domain(own) != "":
        return ""
    return "it is neither a host of ours (--redirect-hosts) nor, over wss://, a name of its domain"


def _domain(url: SplitResult) -> str:
    """Return the domain that a host's name belongs to, or ""."""
    domain = (url.hostname or "").partition(".")[2]
    try:
        ipaddress.ip_address(url.hostname or "")
    except ValueError:
        return domain if "." in domain else ""
    return ""
