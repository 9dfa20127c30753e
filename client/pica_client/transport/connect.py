"""Where a link leads, under which name and with which token; websockets to a relay, with small
buffers and no compression; and what it means when one cannot be opened, or ends.
"""

import asyncio
import binascii
import ipaddress
import json
import logging
import socket
import ssl
import unicodedata
from base64 import urlsafe_b64decode
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from urllib.parse import SplitResult, urlsplit
from urllib.request import getproxies, proxy_bypass

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import (
    InvalidHandshake,
    InvalidMessage,
    InvalidProxy,
    InvalidStatus,
    InvalidURI,
    ProxyError,
    WebSocketException,
)
from websockets.protocol import State
from websockets.proxy import get_proxy
from websockets.typing import Subprotocol
from websockets.uri import parse_uri

from pica_client.errors import OptionError, RelayRefusedError, RelayUnreachableError
from pica_protocol import SUBPROTOCOL
from pica_protocol.errors import MAY_PASS, WORTH_RETRYING, CloseCode
from pica_protocol.limits import (
    MAX_CONTROL_BYTES,
    bound_tls_buffer,
    check_pass,
    check_relay_address,
    check_text,
    check_token,
    text_of_file,
)
from pica_protocol.session import Closed

DEFAULT_URL: Final = "ws://127.0.0.1:8765"
DEFAULT_ROOM: Final = "lobby"
_JOINERS: Final = dict.fromkeys((0x200C, 0x200D))
"""Keyboards of some scripts write them, and relays refuse what is invisible."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkConfig:
    """Where to connect, and under which name."""

    url: str = DEFAULT_URL
    """Address of the relay, ws:// or wss://."""
    redirect_hosts: tuple[str, ...] = ()
    """Other hosts that a relay may redirect us to, with our token. The host of the address needs
    none, nor do, over wss://, other names of its domain."""
    room: str = DEFAULT_ROOM
    """Room to join: 1 to 64 of A-Z a-z 0-9 _ . -"""
    name: str = "guest"
    """Name shown to the others, up to 64 bytes, in Unicode's form NFKC and without joiners."""
    connect_timeout_s: float | None = 3.0
    """How long to try the first time before giving up, seconds; None tries without end."""
    secret_file: Path | None = None
    """File with the room secret; with it, payloads are encrypted end to end. Needs the extra
    `seal`."""
    token_file: Path | None = None
    """File with the token that the relay wants, from `pica token`; read again for every join, so
    that a fresh one can be put there."""
    token: str = field(default="", repr=False)
    """The token itself, instead of a file; a secret."""

    def __post_init__(self) -> None:
        name = unicodedata.normalize("NFKC", self.name)  # wide spaces become ordinary ones
        object.__setattr__(self, "name", name.translate(_JOINERS))
        if self.token and self.token_file is not None:
            raise OptionError("token and token-file say the same thing; give one of them")
        try:
            check_relay_address("url", self.url)
            check_token("room", self.room)
            check_text("name", self.name, 64, required=True)
            check_pass("token", self.token)
        except ValueError as error:
            raise OptionError(str(error)) from error

    def read_token(self) -> str:
        """Return the join token; empty without one.

        Raises:
            OptionError: There is none in the file.
        """
        if self.token_file is None:
            return self.token
        try:
            token = text_of_file(self.token_file.read_bytes()).strip()
            check_pass("token", token)
        except OSError as error:
            raise OptionError(f"token-file {self.token_file}: {error.strerror}") from error
        except ValueError as error:  # no text, or none that can be a token
            raise OptionError(f"token-file {self.token_file}: it holds no token") from error
        return token


def shown_name(name: str, token: str) -> str:
    """Return the name that others are shown: that of the join token, if it has one, or the given
    one. The signature does not matter here: it is our own token."""
    try:
        claims = json.loads(urlsafe_b64decode(token.split(".")[1] + "=="))
        said = claims.get("name", "")
    except (IndexError, binascii.Error, ValueError, AttributeError, RecursionError):
        said = ""
    return said if isinstance(said, str) and said else name


_log = logging.getLogger(__name__)

SOFTWARE: Final = "pica-telepresence"
CLOSE_TIMEOUT_S: Final = 1.0
"""Longest wait for the closing handshake; a relay that is gone does not answer."""
OPEN_TIMEOUT_S: Final = 3.0
"""Longest wait for the opening handshake (chosen: the kernel repeats a lost SYN after 1 s)."""
HAPPY_EYEBALLS_S: Final = 0.25
"""When the next address of a name is tried beside one that has not answered (RFC 8305)."""
MAX_UNSENT_BYTES: Final = 2048
"""In the kernel, before frames begin to wait where newer ones replace them (chosen: thinning does
not work behind a deep buffer)."""
MAX_QUEUED_MESSAGES: Final = 16
"""Websocket messages read ahead; then the network is told to wait."""
CHECK_S: Final = 0.55
"""Time between two checks that the relay was heard; if it was not, it is pinged."""
MAX_UNANSWERED: Final = 3
"""Checks without an answer before the connection is left (chosen: a dead path is left after 2.2 to
2.75 s, and an answer may take 1.65 s)."""
_NOT_TLS: Final = ("WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE", "PACKET_LENGTH_TOO_LONG")
"""What OpenSSL calls an answer that is none of its own."""


class RelayWebsocket(ClientConnection):
    """The library's websocket with small buffers, which leaves a relay that is not heard."""

    _is_heard = True

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Bound what waits below the library."""
        super().connection_made(transport)
        bound_tls_buffer(transport)
        raw = transport.get_extra_info("socket")
        option = getattr(socket, "TCP_NOTSENT_LOWAT", None)
        if option and raw is not None and raw.family in (socket.AF_INET, socket.AF_INET6):
            raw.setsockopt(socket.IPPROTO_TCP, option, MAX_UNSENT_BYTES)

    def data_received(self, data: bytes) -> None:
        """Take what has come."""
        self._is_heard = True
        super().data_received(data)

    async def watch(self) -> None:
        """Ping a relay that is not heard; return once the connection was left for a dead one.

        Checks are counted, not time: a program that slept reads and pings before it judges.
        """
        num_unanswered = 0
        while num_unanswered < MAX_UNANSWERED:
            await asyncio.sleep(CHECK_S)
            num_unanswered = 0 if self._is_heard else num_unanswered + 1
            self._is_heard = False
            if num_unanswered and self.state is State.OPEN:  # without waiting for the answer
                self.protocol.send_ping(b"")
                self.send_data()
        self.transport.abort()


class _Connect(connect):
    """Stays at the address that it was given: a relay redirects by its goodbye, which `redirect_of`
    judges; HTTP would send us anywhere."""

    def process_redirect(self, exc: Exception) -> Exception | str:
        """Follow no redirect of HTTP."""
        return exc


async def open_websocket(url: str, subprotocol: str = SUBPROTOCOL) -> RelayWebsocket:
    """Connect to a relay.

    Raises:
        RelayRefusedError: What answers there is no relay, or no way leads there.
        RelayUnreachableError: There is no answer now, and perhaps later.
    """
    address, bracket, rest = url.partition("]")
    try:
        websocket = await _Connect(
            # The zone of a link-local address, which RFC 6874 writes after an escaped percent sign.
            address.replace("%25", "%") + bracket + rest if bracket else url,
            create_connection=RelayWebsocket,
            subprotocols=[Subprotocol(subprotocol)],
            compression=None,
            max_size=MAX_CONTROL_BYTES,
            max_queue=MAX_QUEUED_MESSAGES,
            # One message in the library; more only once the kernel has taken it. With 0, TLS of
            # the standard library would wait without end.
            write_limit=1,
            ping_interval=None if subprotocol == SUBPROTOCOL else 10,  # a call has `watch`
            close_timeout=CLOSE_TIMEOUT_S,
            open_timeout=OPEN_TIMEOUT_S,
            proxy=proxy_of(url),
            user_agent_header=SOFTWARE,
            happy_eyeballs_delay=HAPPY_EYEBALLS_S,
        )
    except (OSError, EOFError, WebSocketException, UnicodeError, ImportError) as error:
        if reason := _refusal(error):
            raise RelayRefusedError(f"{url}: {reason}") from error
        raise RelayUnreachableError(_trouble(error, url)) from error
    assert isinstance(websocket, RelayWebsocket)
    if websocket.subprotocol != subprotocol:
        websocket.transport.abort()
        raise RelayRefusedError(f"{url}: a websocket server that does not speak {subprotocol}")
    return websocket


def proxy_of(url: str) -> str | None:
    """Return the proxy that the environment names for a relay, for the call and for avatar files;
    None for this machine, and where ``no_proxy`` names the host."""
    with suppress(InvalidURI, ValueError):
        uri = parse_uri(url)
        if not _is_loopback(uri.host) and not proxy_bypass(f"{uri.host}:{uri.port}"):
            return get_proxy(uri) or getproxies().get("all")
    return None


def _is_loopback(host: str) -> bool:
    """Return True if an address is this machine's own."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _refusal(error: BaseException) -> str | None:
    """Return why trying again cannot help, or None if it may."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"its certificate is not trusted: {error.verify_message.rstrip('.')} (SSL_CERT_FILE)"
    if isinstance(error, InvalidURI | UnicodeError):
        return f"is no websocket address ({error})"
    if isinstance(error, InvalidProxy | ImportError):
        return f"is not to be reached by the proxy that the environment names ({error})"
    if isinstance(error, InvalidStatus):
        status = error.response.status_code
        return None if status in (429, 502, 503, 504) else f"answers HTTP {status}, not as a relay"
    if isinstance(error, InvalidHandshake) and not isinstance(error, InvalidMessage | ProxyError):
        return f"is no PiCA relay of this version ({error})"
    return None


def _trouble(error: BaseException, url: str) -> str:
    """Return what stands in the way of a websocket now, and perhaps not later."""
    cause = error.__cause__
    has_tls = url.startswith("wss://")
    if isinstance(cause, EOFError) or isinstance(error, ConnectionResetError):
        other = "ws:// if it is a relay without TLS" if has_tls else "wss:// if it speaks TLS"
        return f"something answers and hangs up; write {other}"
    if isinstance(error, ssl.SSLError) and error.reason in _NOT_TLS:
        return "something answers without TLS; write ws:// if that is the relay"
    if isinstance(error, InvalidMessage) and isinstance(cause, ValueError):
        words = str(cause).rpartition(": ")[2]
        return f"something answers that is no relay: {words[:60]!r}"
    proxy = proxy_of(url)
    way = f" by the proxy {urlsplit(proxy).hostname}" if proxy else ""
    return f"{str(error) or 'no answer'}{way}"


PROTOCOL_BROKEN: Final = (CloseCode.MALFORMED, CloseCode.UNEXPECTED_MESSAGE)
"""How a connection ends on which one end broke the protocol."""


def refusal_of(url: str, closed: Closed) -> RelayRefusedError | None:
    """Return what it means that a relay closed a connection, or None: come back at once."""
    # What we could not read may have been a passing fault of the relay: try again, slower.
    is_ours = closed.code in PROTOCOL_BROKEN and not closed.is_remote
    if closed.code in WORTH_RETRYING or is_ours:
        return None
    return RelayRefusedError(
        f"{url}: the relay said no: {closed.reason or 'no reason'} (code {closed.code})",
        may_pass=closed.code in MAY_PASS,
        code=closed.code,
    )


def redirect_of(closed: Closed | None, current: str, config: LinkConfig) -> str:
    """Return the other relay that a connection ended with, if we may go there, or "".

    The address in a goodbye is not to be trusted: following it blindly, we would contact any
    machine that we can reach, those of our own network among them, and join there with our token.
    So we follow

        to a host of our configuration                  any port, no path but ours
        over wss:// to another name of the same domain  its certificate proves that it is

    and not from ``wss://`` to ``ws://``. Of "a.example.org" the domain is "example.org"; a name
    without a dot after its first part has none.
    """
    if closed is None or closed.code != CloseCode.GOING_AWAY or not closed.url:
        return ""
    there, own = urlsplit(closed.url), urlsplit(config.url)
    why = "it is neither a host of ours (--redirect-hosts) nor, over wss://, a name of its domain"
    if urlsplit(current).scheme == "wss" and there.scheme != "wss":
        why = "connections are not encrypted there"
    elif there.path.rstrip("/") not in ("", own.path.rstrip("/")) or there.query or there.fragment:
        why = "it has a path that is not ours"
    elif there.hostname in (own.hostname, *map(str.lower, config.redirect_hosts)) or (
        there.scheme == "wss" and _domain(there) == _domain(own) != ""
    ):
        return closed.url
    _log.warning("the relay redirects us; not following: %s", why)
    return ""


def _domain(url: SplitResult) -> str:
    """Return the domain that a host's name belongs to, or ""."""
    domain = (url.hostname or "").partition(".")[2]
    try:
        ipaddress.ip_address(url.hostname or "")
    except ValueError:
        return domain if "." in domain else ""
    return ""
