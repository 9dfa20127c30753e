"""Opening one websocket to a relay: small buffers, no compression, and what an error means."""

import ipaddress
import socket
import ssl
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidHandshake, InvalidMessage, InvalidStatus, InvalidURI

from pica_client.errors import OptionError
from pica_protocol import SUBPROTOCOL
from pica_protocol.limits import MAX_CONTROL_BYTES

SOFTWARE: Final = "pica-telepresence"
CLOSE_TIMEOUT_S: Final = 1.0
"""Longest wait for a websocket's goodbye; a relay that is gone does not answer."""
PING_INTERVAL_S: Final = 5.0
PING_TIMEOUT_S: Final = 10.0
"""A relay that says nothing for 15 s is gone, even when its socket is not (chosen)."""
MAX_UNSENT_BYTES: Final = 2048
"""In the kernel, before frames begin to wait where they can be thinned: about thirty of a layered
stream (chosen: thinning does not work behind a deep buffer)."""
MAX_QUEUED_MESSAGES: Final = 16
"""Websocket messages read ahead of us; then the network is told to wait."""


async def open_websocket(
    url: str, ca_file: Path | None = None, *, subprotocol: str = SUBPROTOCOL
) -> ClientConnection:
    """Open a websocket to a relay with our settings, small buffers among them.

    Args:
        url: Of the relay.
        ca_file: With wss://, certificates to trust instead of the system's.
        subprotocol: What is to be spoken.

    Raises:
        OptionError: There are no certificates in the file.
    """
    host = urlsplit(url).hostname or ""
    websocket = await connect(
        url,
        subprotocols=[subprotocol],  # type: ignore[list-item]
        compression=None,
        max_size=MAX_CONTROL_BYTES,
        max_queue=MAX_QUEUED_MESSAGES,
        # One message in the library; more only once the kernel has taken it. Of 0, TLS of the
        # standard library would make no end of waiting.
        write_limit=1,
        ping_interval=PING_INTERVAL_S,
        ping_timeout=PING_TIMEOUT_S,
        close_timeout=CLOSE_TIMEOUT_S,
        open_timeout=5.0,
        proxy=None if is_loopback(host) else True,
        user_agent_header=SOFTWARE,
        **_tls(url, ca_file),
    )
    # Under TLS there is a plain transport with a buffer of its own, and no public way to it.
    plain = getattr(getattr(websocket.transport, "_ssl_protocol", None), "_transport", None)
    if plain is not None:
        plain.set_write_buffer_limits(high=0)
    raw = websocket.transport.get_extra_info("socket")
    option = getattr(socket, "TCP_NOTSENT_LOWAT", None)
    if raw is not None and option is not None and raw.family != getattr(socket, "AF_UNIX", None):
        raw.setsockopt(socket.IPPROTO_TCP, option, MAX_UNSENT_BYTES)
    return websocket


def _tls(url: str, ca_file: Path | None) -> dict[str, Any]:
    if ca_file is None or not url.startswith("wss://"):
        return {}
    return {"ssl": trusting(ca_file)}


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
    if isinstance(error, InvalidURI):
        return f"is no websocket address ({error})"
    if isinstance(error, InvalidStatus):
        status = error.response.status_code
        return None if status in (429, 502, 503, 504) else f"answers HTTP {status}, not as a relay"
    if isinstance(error, InvalidHandshake) and not isinstance(error, InvalidMessage):
        return f"is no PiCA relay of this version ({error})"
    return None
