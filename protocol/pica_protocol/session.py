"""Both ends of one connection, without the connection: bytes in, events out, bytes to send.

A shell does four things with a session, and nothing else::

    events = session.receive_data(data, now)        what a websocket message means
    data   = session.messages_to_send(now)          what must go out, in order
    when   = session.next_timer()                   when it wants to be woken, or None
    events = session.handle_timer(now)              it is that time

plus ``receive_close`` when the socket has ended. A session never raises for what the other side
sent: it queues a ``Bye``, reports ``Closed`` and is done; the shell sends what is left and closes
the websocket with the code and reason of ``session.closed``. It raises ``LocalProtocolError`` for
what this side must not do.

Events come back from the call that caused them. A queue to drain separately would be one more thing
that a shell can forget.

    Client                                 Relay's side
    JOINING   Join is out                  JOINING   nothing received
    JOINED    Joined received              DECIDING  Join received; accept() or close() is due
    LEAVING   Leave is out                 JOINED    Joined is out
    CLOSED                                 CLOSED

Media flows while JOINED. The version is agreed upon as the sub-protocol of the websocket. What may
be received in which state, and where it leads, stands in the two tables below; all else is
``UNEXPECTED_MESSAGE``. ``Bye`` ends every state.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Final, get_args

from pica_protocol.codec import CONTROL_KIND, decode_message, encode_message
from pica_protocol.errors import CloseCode, LocalProtocolError, RemoteProtocolError
from pica_protocol.frames import MEDIA_KIND, Frame, FrameSpan, scan_frames
from pica_protocol.limits import MAX_CLIENT_MESSAGE_BYTES, clipped_reason, quoted
from pica_protocol.messages import (
    Bye,
    FromMember,
    Join,
    Joined,
    Leave,
    Message,
    RoomNews,
)

HANDSHAKE_TIMEOUT_S: Final = 5.0
"""Seconds from the open socket to the place in the room (chosen: ten slow round trips)."""


class State(Enum):
    """Where a session stands; each side uses its own subset, see above."""

    JOINING = "joining"
    DECIDING = "deciding"
    JOINED = "joined"
    LEAVING = "leaving"
    CLOSED = "closed"


class Media:
    """Stands for media messages in the tables."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Closed:
    """The session is over."""

    code: int
    """A ``CloseCode``, or whatever else the websocket was closed with."""
    reason: str
    is_remote: bool
    """Whether the other side, or the network, ended it."""
    url: str = ""
    """Another relay to go to, if the other side named one."""


ClientEvent = Joined | RoomNews | Frame | Closed
ServerEvent = Join | FromMember | Closed

_Table = Mapping[State, Mapping[type, State]]

_OF_A_ROOM: Final[tuple[type, ...]] = (*get_args(RoomNews), Media)

CLIENT_TABLE: Final[_Table] = {
    State.JOINING: {Joined: State.JOINED},
    State.JOINED: dict.fromkeys(_OF_A_ROOM, State.JOINED),
    # What was under way when Leave went out still arrives.
    State.LEAVING: dict.fromkeys((Joined, *_OF_A_ROOM), State.LEAVING),
    State.CLOSED: {},
}

SERVER_TABLE: Final[_Table] = {
    State.JOINING: {Join: State.DECIDING, Leave: State.CLOSED},
    State.DECIDING: {Leave: State.CLOSED},
    State.JOINED: {
        **dict.fromkeys((*get_args(FromMember), Media), State.JOINED),
        Leave: State.CLOSED,
    },
    State.CLOSED: {},
}


class Session:
    """What both ends share: the table, the outgoing control messages, the deadline and the end."""

    def __init__(self, table: _Table, max_bytes: int, deadline: float) -> None:
        self.state = State.JOINING
        self.closed: Closed | None = None
        self._table = table
        self._max_bytes = max_bytes
        self._deadline: float | None = deadline
        self._outgoing: list[bytes] = []

    def next_timer(self) -> float | None:
        """Return when ``handle_timer`` is due, or None."""
        return self._deadline

    def receive_close(self, code: int, reason: str, now: float) -> list[Closed]:
        """Take note that the websocket has ended; after a ``Bye`` this is no news."""
        if self.state is State.CLOSED:
            return []
        return [self._end(code, reason, is_remote=True)]

    def close(self, code: int, reason: str, url: str = "") -> None:
        """End the session from this side: ``Bye`` goes out, then the shell closes the websocket."""
        if self.state is not State.CLOSED:
            self._end(code, reason, is_remote=False, url=url)

    def _advance(self, received: type) -> None:
        """Take the step of the table, or refuse the message."""
        state = self._table[self.state].get(received)
        if state is None:
            raise RemoteProtocolError(
                f"unexpected {received.__name__} while {self.state.value}",
                CloseCode.UNEXPECTED_MESSAGE,
            )
        self.state = state

    def _queue(self, message: Message) -> None:
        self._outgoing.append(encode_message(message))

    def _end(self, code: int, reason: str, *, is_remote: bool, url: str = "") -> Closed:
        reason = clipped_reason(reason)
        if not is_remote:
            self._queue(Bye(code=code, reason=reason, url=url))
        self.state = State.CLOSED
        self.closed = Closed(code=code, reason=reason, is_remote=is_remote, url=url)
        self._deadline = None
        return self.closed


def binary(data: bytes | str) -> bytes:
    """Refuse a text message, and one of an unknown kind."""
    if isinstance(data, str):
        raise RemoteProtocolError("text message, all messages are binary")
    if len(data) == 0 or data[0] not in (CONTROL_KIND, MEDIA_KIND):
        raise RemoteProtocolError(f"unknown kind of message, first byte {quoted(data[:1])}")
    return data


_JOINED: Final = State.JOINED  # looked up once for every frame


class ServerSession(Session):
    """The relay's end: has the relay decide on the join, and passes on what follows."""

    def __init__(self, *, now: float, timeout_s: float = HANDSHAKE_TIMEOUT_S):
        """Start on a websocket that is open; the client speaks first."""
        super().__init__(SERVER_TABLE, MAX_CLIENT_MESSAGE_BYTES, now + timeout_s)

    def receive_data(self, data: bytes | str, now: float) -> list[ServerEvent]:
        """Take one websocket message, of which media goes to `receive_media`; after a ``Join``
        event the relay owes the client ``accept`` or ``close``."""
        if self.state is State.CLOSED:
            return []
        try:
            data = binary(data)
            if data[0] == MEDIA_KIND:
                self.receive_media(data)
                return [] if self.closed is None else [self.closed]
            return self._receive_message(decode_message(data, self._max_bytes))
        except RemoteProtocolError as error:
            return [self._end(error.code, str(error), is_remote=False)]

    def receive_media(self, message: bytes) -> list[FrameSpan]:
        """Take one media message; return its frames, or none and be closed."""
        try:
            if self.state is not _JOINED:  # where the table leads nowhere else
                if self.state is State.CLOSED:
                    return []
                self._advance(Media)
            return scan_frames(message)
        except RemoteProtocolError as error:
            self._end(error.code, str(error), is_remote=False)
            return []

    def messages_to_send(self, now: float) -> list[bytes]:
        """Take the control messages that must go out now, in order."""
        data, self._outgoing = self._outgoing, []
        return data

    def handle_timer(self, now: float) -> list[ServerEvent]:
        """Close a connection that has not asked to join by now."""
        if self._deadline is None or now < self._deadline:
            return []
        return [self._end(CloseCode.HANDSHAKE_TIMEOUT, "no join in time", is_remote=False)]

    def accept(self, joined: Joined) -> None:
        """Let the client in; ``close`` is the other answer to a ``Join``."""
        if self.state is not State.DECIDING:
            raise LocalProtocolError(f"no join was asked for: {self.state.value}")
        self.state = State.JOINED
        self._deadline = None
        self._queue(joined)

    def _receive_message(self, message: Message) -> list[ServerEvent]:
        if isinstance(message, Bye):
            return [self._end(message.code, message.reason, is_remote=True)]
        self._advance(type(message))
        if isinstance(message, Leave):
            self._queue(Bye(code=CloseCode.NORMAL, reason="left"))
            return [self._end(CloseCode.NORMAL, "left", is_remote=True)]
        assert isinstance(message, Join | FromMember)  # so says the table
        return [message]
