"""The relay's end of a connection; see `pica_protocol.session` for how a shell uses it."""

from typing import Final

from pica_protocol import messages, session
from pica_protocol.codec import decode_message
from pica_protocol.errors import CloseCode, LocalProtocolError, RemoteProtocolError
from pica_protocol.frames import MEDIA_KIND, FrameSpan, scan_frames
from pica_protocol.limits import MAX_CLIENT_MESSAGE_BYTES

_JOINED: Final = session.State.JOINED  # looked up once for every frame


class ServerSession(session.Session):
    """The relay's end: greets back, has the relay decide on the join, passes on what follows."""

    def __init__(
        self, *, software: str = "", now: float, timeout_s: float = session.HANDSHAKE_TIMEOUT_S
    ):
        """Start on a websocket that is open; the client speaks first."""
        super().__init__(session.SERVER_TABLE, MAX_CLIENT_MESSAGE_BYTES, now + timeout_s)
        self._software = software

    def receive_data(self, data: bytes | str, now: float) -> list[session.ServerEvent]:
        """Take one websocket message, of which media goes to `receive_media`; after a ``Join``
        event the relay owes the client ``accept`` or ``close``."""
        if self.state is session.State.CLOSED:
            return []
        try:
            data = session.binary(data)
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
                if self.state is session.State.CLOSED:
                    return []
                self._advance(session.Media)
            return scan_frames(message)
        except RemoteProtocolError as error:
            self._end(error.code, str(error), is_remote=False)
            return []

    def messages_to_send(self, now: float) -> list[bytes]:
        """Take the control messages that must go out now, in order."""
        data, self._outgoing = self._outgoing, []
        return data

    def handle_timer(self, now: float) -> list[session.ServerEvent]:
        """Close a connection that has not asked to join by now."""
        if self._deadline is None or now < self._deadline:
            return []
        awaited = "hello" if self.state is session.State.GREETING else "join"
        reason = f"no {awaited} in time"
        return [self._end(CloseCode.HANDSHAKE_TIMEOUT, reason, is_remote=False)]

    def accept(self, joined: messages.Joined) -> None:
        """Let the client in; ``close`` is the other answer to a ``Join``."""
        if self.state is not session.State.DECIDING:
            raise LocalProtocolError(f"no join was asked for: {self.state.value}")
        self.state = session.State.JOINED
        self._deadline = None
        self._queue(joined)

    def _receive_message(self, message: messages.Message) -> list[session.ServerEvent]:
        if isinstance(message, messages.Bye):
            return [self._end(message.code, message.reason, is_remote=True)]
        self._advance(type(message))
        match message:
            case messages.Hello():
                session.check_version(message.version)
                self._queue(messages.Welcome(software=self._software))
                return []
            case messages.Leave():
                self._queue(messages.Bye(code=CloseCode.NORMAL, reason="left"))
                return [self._end(CloseCode.NORMAL, "left", is_remote=True)]
        if isinstance(message, messages.Join | messages.FromMember):
            return [message]
        raise AssertionError(f"the table admits {message}, which is not handled")
