"""Opening one websocket to a relay: small buffers, no compression, and what an error means."""

import asyncio
import ipaddress
import socket
import ssl
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

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

from pica_client.errors import OptionError
from pica_protocol import SUBPROTOCOL
from pica_protocol.limits import MAX_CONTROL_BYTES
from pica_protocol.tls_buffer import bound_tls_buffer

SOFTWARE: Final = "pica-telepresence"
CLOSE_TIMEOUT_S: Final = 1.0
"""Longest wait for a websocket's goodbye; a relay that is gone does not answer."""
MAX_UNSENT_BYTES: Final = 2048
"""In the kernel, before frames begin to wait where they can be thinned: about thirty of a layered
stream (chosen: thinning does not work behind a deep buffer)."""
PING_S: Final = 10.0
"""Between two pings of an upload, and for their answers; in a call `silence.Silence` says when."""
MAX_QUEUED_MESSAGES: Final = 16
"""Websocket messages read ahead of us; then the network is told to wait."""
CONNECT_ERRORS: Final = (OSError, EOFError, WebSocketException, UnicodeError, ImportError)
"""All that `open_websocket` may raise of the network, of an address and of a proxy; what each means
say `refusal` and `trouble`."""
_NOT_TLS: Final = ("WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE", "PACKET_LENGTH_TOO_LONG")
"""What OpenSSL calls an answer that is none of its own."""


class RelayWebsocket(ClientConnection):
    """The library's websocket, which also knows when the relay was heard last.

    Attributes:
        heard_s: When the latest bytes came, pongs among them, by the time of the event loop.
    """

    heard_s = 0.0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin to listen."""
        self.heard_s = self.loop.time()
        super().connection_made(transport)

    def data_received(self, data: bytes) -> None:
        """Take what has come."""
        self.heard_s = self.loop.time()
        super().data_received(data)

    def ask(self) -> None:
        """Send a ping and wait for nothing: `heard_s` tells whether it was answered."""
        if self.state is State.OPEN:
            self.protocol.send_ping(b"")
            self.send_data()


class _Dial(connect):
    """Opens a websocket at the address that was asked for, and at no other.

    A relay sends us elsewhere by its goodbye, which `transport.redirects` judges; HTTP would send
    us anywhere.
    """

    def process_redirect(self, exc: Exception) -> Exception | str:
        return exc


async def open_websocket(
    url: str, ca_file: Path | None = None, *, subprotocol: str = SUBPROTOCOL
) -> RelayWebsocket:
    """Open a websocket to a relay with our settings, small buffers among them.

    Args:
        ca_file: With wss://, certificates to trust instead of the system's.

    Raises:
        OptionError: There are no certificates in the file.
    """
    host = urlsplit(url).hostname or ""
    tls: dict[str, Any] = {}
    if ca_file is not None and url.startswith("wss://"):
        tls["ssl"] = trusting(ca_file)
    websocket = await _Dial(
        url,
        create_connection=RelayWebsocket,
        subprotocols=[subprotocol],  # type: ignore[list-item]
        compression=None,
        max_size=MAX_CONTROL_BYTES,
        max_queue=MAX_QUEUED_MESSAGES,
        # One message in the library; more only once the kernel has taken it. Of 0, TLS of the
        # standard library would make no end of waiting.
        write_limit=1,
        ping_interval=None if subprotocol == SUBPROTOCOL else PING_S,
        ping_timeout=PING_S,
        close_timeout=CLOSE_TIMEOUT_S,
        open_timeout=5.0,
        proxy=None if is_loopback(host) else True,
        user_agent_header=SOFTWARE,
        **tls,
    )
    assert isinstance(websocket, RelayWebsocket)
    bound_tls_buffer(websocket.transport)
    raw = websocket.transport.get_extra_info("socket")
    option = getattr(socket, "TCP_NOTSENT_LOWAT", None)
    if raw is not None and option is not None and raw.family != getattr(socket, "AF_UNIX", None):
        raw.setsockopt(socket.IPPROTO_TCP, option, MAX_UNSENT_BYTES)
    return websocket


def trusting(ca_file: Path) -> ssl.SSLContext:
    """What trusts the certificates of a file, and no others.

    Raises:
        OptionError: There are none in it.
    """
    try:
        return ssl.create_default_context(cafile=ca_file)
    except ssl.SSLError as error:
        raise OptionError(f"ca-file {ca_file}: it holds no certificate in PEM format") from error
    except OSError as error:
        raise OptionError(f"ca-file {ca_file}: {error.strerror}") from error


def is_loopback(host: str) -> bool:
    """Whether a proxy from the environment must not get in the way."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def refusal(error: BaseException) -> str | None:
    """Why trying again cannot help, or None if it may."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"its certificate is not trusted: {error.verify_message.rstrip('.')} (--ca-file)"
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


def trouble(error: BaseException, url: str) -> str:
    """What stands in the way of a websocket now, and perhaps not later: who answers there."""
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
    return str(error) or "nobody answered"
