"""Both ends of one connection, without the connection: bytes in, events out, bytes to send.

A shell does four things with a session, and nothing else::

    events = session.receive_data(data, now)        what a websocket message means
    data   = session.messages_to_send(now)          what must go out, in order
    when   = session.next_timer()                   when it wants to be woken, or None
    events = session.handle_timer(now)              it is that time

plus ``receive_close`` when the socket has ended. A session never raises for what the other side
sent: it queues a ``Bye``, reports ``Closed`` and is done; the shell sends what is left and closes
the websocket with the code and reason of ``session.closed``.

Events come back from the call that caused them. A queue to drain separately would be one more thing
that a shell can forget.

    Client                                 Relay's side
    JOINING   Join is out                  JOINING   nothing received
    JOINED    Joined received              DECIDING  Join received; accept() or close() is due
    CLOSED                                 JOINED    Joined is out
                                           CLOSED

Media flows while JOINED. The version is agreed upon as the sub-protocol of the websocket. What may
be received in which state, and where it leads, stands in the two tables below; all else is
``UNEXPECTED_MESSAGE``. ``Bye`` ends every state: its sender reads nothing more.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Final, Generic, TypeVar, get_args

from pica_protocol.codec import decode_message, encode_message
from pica_protocol.errors import CloseCode, RemoteProtocolError
from pica_protocol.frames import MEDIA_PREFIX, Frame, FrameSpan, scan_frames
from pica_protocol.limits import MAX_CLIENT_MESSAGE_BYTES, clipped_reason
from pica_protocol.messages import Bye, FromMember, Join, Joined, Message, RoomNews

HANDSHAKE_TIMEOUT_S: Final = 5.0
"""Seconds from the open socket to the place in the room (chosen: ten slow round trips)."""


class State(Enum):
    """Where a session stands; each side uses its own subset, see above."""

    JOINING = "joining"
    DECIDING = "deciding"
    JOINED = "joined"
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

CLIENT_TABLE: Final[_Table] = {
    State.JOINING: {Joined: State.JOINED},
    State.JOINED: dict.fromkeys((*get_args(RoomNews), Media), State.JOINED),
    State.CLOSED: {},
}

SERVER_TABLE: Final[_Table] = {
    State.JOINING: {Join: State.DECIDING},
    State.DECIDING: {},
    State.JOINED: dict.fromkeys((*get_args(FromMember), Media), State.JOINED),
    State.CLOSED: {},
}

E = TypeVar("E")


class Session(ABC, Generic[E]):
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

    def handle_timer(self, now: float) -> list[E | Closed]:
        """Close a connection that has not led into the room by now."""
        if self._deadline is None or now < self._deadline:
            return []
        reason = f"the handshake took too long: still {self.state.value}"
        return [self._end(CloseCode.HANDSHAKE_TIMEOUT, reason, is_remote=False)]

    def receive_data(self, data: bytes | str, now: float) -> list[E | Closed]:
        """Take one websocket message; a text one is the other side's mistake."""
        if self.state is State.CLOSED:
            return []
        try:
            if isinstance(data, str):
                raise RemoteProtocolError("text message, all messages are binary")
            if data.startswith(MEDIA_PREFIX):
                return self._receive_frames(data, now)
            message = decode_message(data, self._max_bytes)
            if isinstance(message, Bye):
                return [self._end(message.code, message.reason, is_remote=True, url=message.url)]
            self._advance(type(message))
            return self._receive_message(message)
        except RemoteProtocolError as error:
            return [self._end(error.code, str(error), is_remote=False)]

    def messages_to_send(self, now: float) -> list[bytes]:
        """Take the websocket messages that must go out now, in order."""
        data, self._outgoing = self._outgoing, []
        return data

    def receive_close(self, code: int, reason: str, now: float) -> list[Closed]:
        """Take note that the websocket has ended; after a ``Bye`` this is no news."""
        if self.state is State.CLOSED:
            return []
        return [self._end(code, reason, is_remote=True)]

    def close(self, code: int = CloseCode.NORMAL, reason: str = "left", url: str = "") -> None:
        """End the session from this side, by default to leave for good: ``Bye`` goes out, then the
        shell closes the websocket."""
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

    @abstractmethod
    def _receive_frames(self, data: bytes, now: float) -> list[E | Closed]:
        """Take a media message."""

    @abstractmethod
    def _receive_message(self, message: Message) -> list[E | Closed]:
        """Take a control message that the table allows."""


_JOINED: Final = State.JOINED  # looked up once for every frame


class ServerSession(Session[Join | FromMember]):
    """The relay's end: has the relay decide on the join, and passes on what follows.

    After a ``Join`` event the relay owes the client ``accept`` or ``close``.
    """

    def __init__(self, *, now: float, timeout_s: float = HANDSHAKE_TIMEOUT_S):
        """Start on a websocket that is open; the client speaks first."""
        super().__init__(SERVER_TABLE, MAX_CLIENT_MESSAGE_BYTES, now + timeout_s)

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

    def accept(self, joined: Joined) -> None:
        """Let the client in; ``close`` is the other answer to a ``Join``."""
        assert self.state is State.DECIDING
        self.state = State.JOINED
        self._deadline = None
        self._queue(joined)

    def _receive_frames(self, data: bytes, now: float) -> list[ServerEvent]:
        self.receive_media(data)
        return [] if self.closed is None else [self.closed]

    def _receive_message(self, message: Message) -> list[ServerEvent]:
        assert isinstance(message, Join | FromMember)  # so says the table
        return [message]
