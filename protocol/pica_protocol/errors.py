"""Why a connection ended, and what it means."""

from enum import IntEnum
from typing import Final


class CloseCode(IntEnum):
    """Why a connection ended: in ``Bye`` and in the websocket close frame alike.

    Below 4000 the meaning is that of RFC 6455 section 7.4.1; 4000 and up are ours.
    """

    NORMAL = 1000
    """The peer left on purpose."""
    GOING_AWAY = 1001
    """The relay, or the client, is stopping."""
    PROTOCOL_ERROR = 1002
    """Bytes that are no websocket; sent by the websocket layer itself."""
    CONNECTION_LOST = 1006
    """Never sent: what a side concludes when the socket dies without a close frame."""
    INVALID_TEXT = 1007
    """A text message, or a close reason, that is no UTF-8; sent by the websocket layer itself."""
    MESSAGE_TOO_BIG = 1009
    """A websocket message above the limit, or in too many fragments; sent by the websocket layer
    itself."""
    INTERNAL_ERROR = 1011
    """A fault of the relay, or a peer that stopped answering pings."""
    MALFORMED = 4000
    """Bytes that are no message, or a field out of its limits."""
    WRONG_VERSION = 4001
    """The other side does not speak this sub-protocol."""
    UNEXPECTED_MESSAGE = 4002
    """A good message at the wrong time; see the state tables."""
    HANDSHAKE_TIMEOUT = 4003
    """The join, or its answer, did not come in time."""
    ROOM_FULL = 4004
    """The room has as many peers as the relay allows."""
    TOO_SLOW = 4005
    """The peer does not read: control messages pile up, or nothing leaves for too long."""
    FOREIGN_STREAM = 4006
    """A frame on a stream that is not the sender's own."""
    RELAY_FULL = 4007
    """The relay has as many connections as it allows."""
    TOO_FAST = 4008
    """More messages, frames or bytes than one client may send."""
    BUSY = 4009
    """More joins at once than the relay takes; later there will be room."""
    TOO_MANY = 4010
    """One address holds as many connections as it may."""
    UNAUTHORIZED = 4011
    """No token, or none that is good for this room and this moment."""
    FORBIDDEN = 4012
    """The token does not allow what is asked for, or an admin has barred its identity."""
    REPLACED = 4013
    """The same identity has joined again from elsewhere; the newer one stays."""
    UNFIT_FILE = 4014
    """An uploaded file is not the one that was offered."""
    STORE_FULL = 4015
    """The avatar store has no room for this file, or takes none as large."""
    REMOVED = 4016
    """An admin has removed this peer from the room."""


WORTH_RETRYING: Final = (
    CloseCode.GOING_AWAY,
    CloseCode.CONNECTION_LOST,
    CloseCode.INTERNAL_ERROR,
    CloseCode.HANDSHAKE_TIMEOUT,
    CloseCode.TOO_SLOW,
    CloseCode.RELAY_FULL,
    CloseCode.BUSY,
    1005,  # closed without a code
    1012,  # service restart, from a proxy
    1013,  # try again later, from a proxy
    1014,  # bad gateway, from a proxy
)
"""The same join may succeed later without any change."""
MAY_PASS: Final = (CloseCode.ROOM_FULL, CloseCode.TOO_MANY, CloseCode.UNAUTHORIZED)
"""Refusals of a peer that was in the room a moment ago that may be over in a minute: a ghost holds
its place, a clock or a key file is about to be mended."""


class RemoteProtocolError(Exception):
    """The other side sent what it must not; ``code`` is what to close the connection with."""

    def __init__(self, message: str, code: CloseCode = CloseCode.MALFORMED) -> None:
        super().__init__(message)
        self.code = code
