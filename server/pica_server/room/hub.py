"""All that a relay decides, put together: what happens to whom. No socket, no clock.

The shell tells the hub what happened (``connect``, ``receive``, ``disconnect``, ``handle_timer``),
asks which connections have something to send (``take_ready``) and takes it from them one message at
a time (``take``, ``sent``). The parts decide:

    connections   the connections: how they begin and end, who is late, what passes between them
    membership    rooms: who comes, goes, is away for a while and comes back, and what admins do

A connection is over when its ``closed`` is set; what it still has to send ends with a ``Bye``.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Final

from pica_protocol.errors import RemoteProtocolError
from pica_protocol.frames import MEDIA_PREFIX, scan_frames
from pica_protocol.messages import (
    BarIdentity,
    Join,
    MutePeer,
    RemovePeer,
    Subscribe,
    UpdateMetadata,
    Whisper,
)
from pica_protocol.session import Closed, ServerEvent
from pica_server.config import RelayConfig
from pica_server.limits import RefusalError
from pica_server.room.connections import MESSAGE_COST_BYTES, Connections, Overload
from pica_server.room.membership import Membership
from pica_server.room.outbox import OutboundMessage
from pica_server.room.room import Connection
from pica_server.stats import RelayStats
from pica_server.tokens import Admission

TELLING_SHARE: Final = 0.5
"""The share of a drain's time in which all are told; the rest is left for them to go (chosen)."""


class Hub:
    """The relay without its sockets."""

    def __init__(
        self,
        config: RelayConfig,
        admit: Callable[[Join], Admission] | None = None,
        *,
        new_secret: Callable[[], str] | None = None,
    ) -> None:
        """Begin empty.

        Args:
            admit: Says what who joins may do, or raises `RefusalError`; everybody may do
                everything by default.
            new_secret: Makes secrets to come back with; without it no place is kept.
        """
        self.stats = RelayStats()
        self.connections = Connections(config, self.stats)
        self.overload = Overload()
        self.membership = Membership(
            self.connections, admit or (lambda join: Admission()), self.overload, new_secret
        )
        self._config = config
        self._departures: deque[tuple[float, str]] = deque()

    @property
    def num_connections(self) -> int:
        """Connections that are not over yet."""
        return len(self.connections.open)

    @property
    def num_rooms(self) -> int:
        """Rooms with peers in them."""
        return len(self.membership.rooms)

    def takes_rooms(self, now: float) -> bool:
        """Whether there is a place for rooms that are placed on this relay."""
        connections = self.connections
        return not (connections.is_full or connections.is_draining or self.overload.refuses(now))

    def connect(self, now: float, address: str = "") -> Connection:
        """Take a new websocket, see `Connections.connect`."""
        return self.connections.connect(now, address)

    def receive(self, connection: Connection, messages: Sequence[bytes | str], now: float) -> None:
        """Take the websocket messages of a connection that came together."""
        # Once for every message that comes: written for speed.
        session = connection.session
        last: dict[int, int] | None = None
        if len(messages) > 1 and self.overload.sheds:
            last = _last_frames(messages)
        for data in messages:
            self.stats.bytes_in += len(data)
            if isinstance(data, bytes) and data.startswith(MEDIA_PREFIX):  # nearly always
                spans = session.receive_media(data)
                cost_bytes = len(data) + MESSAGE_COST_BYTES * (len(spans) or 1)
                if not connection.bytes_in.take(now, cost_bytes):
                    self.connections.close_too_fast(connection, now)
                if session.closed is None:
                    self.connections.forward(connection, data, spans, now, last)
                else:
                    self.membership.clear_up(connection, now)
                continue
            if not connection.bytes_in.take(now, len(data) + MESSAGE_COST_BYTES):
                self.connections.close_too_fast(connection, now)
            for event in session.receive_data(data, now):
                self._handle(connection, event, now)
            self.connections.flush(connection, now)

    def disconnect(self, connection: Connection, code: int, reason: str, now: float) -> None:
        """Take note that a websocket has ended."""
        for event in connection.session.receive_close(code, reason, now):
            self._handle(connection, event, now)

    def drain(self, now: float) -> None:
        """Begin to close all connections: those without a room at once, then room by room.

        All that waits for them goes out before their goodbye. No peer is admitted any more.
        """
        config, connections, rooms = self._config, self.connections, self.membership.rooms
        connections.is_draining = True
        roomless = [each for each in connections.open if each.room is None]
        connections.send_elsewhere(roomless, now)
        # Rooms follow each other as fast as a relay with our own limits lets peers join, or as fast
        # as the time allows; each goes together, so its people keep sight of each other.
        num_people = sum(len(room.members) for room in rooms.values())
        longest_s = min(num_people / config.limits.joins_per_s, TELLING_SHARE * config.drain_s)
        num_gone = 0
        for name, room in rooms.items():
            self._departures.append((now + longest_s * num_gone / num_people, name))
            num_gone += len(room.members)
        self._send_rooms_away(now)

    def take_ready(self) -> list[Connection]:
        """Take the list of connections that have got something to send, or have closed."""
        taken = self.connections.ready
        self.connections.ready = []
        return taken

    def take(self, connection: Connection, now: float) -> OutboundMessage | None:
        """Take the next message for a connection; the shell calls ``sent`` when it is out."""
        message = connection.outbox.take(now)
        if message is not None:
            connection.late_s = now + self._config.stall_timeout_s
        return message

    def is_sending(self, connection: Connection, now: float) -> None:
        """Take note that a socket did not take a message at once; ``sent`` follows when it has."""
        connection.late_s = now + self._config.stall_timeout_s
        connection.outbox.note_full(now)

    def sent(self, connection: Connection, message: OutboundMessage, now: float) -> None:
        """Take note that the socket took a message."""
        connection.late_s = math.inf
        self.stats.note_sent(1, len(message.data), message.num_frames, now - message.received_s)

    def handle_timer(self, now: float) -> None:
        """Close those who are late by now, and those whose turn to go has come; called many times
        a second."""
        self._send_rooms_away(now)
        self.membership.handle_timer(now)
        self.connections.handle_timer(now)

    def _send_rooms_away(self, now: float) -> None:
        while self._departures and self._departures[0][0] <= now:
            _, name = self._departures.popleft()
            placement = self.membership.placement
            url = "" if placement is None else placement.refuge()
            self.membership.send_elsewhere(name, [], url, now)

    def _handle(self, connection: Connection, event: ServerEvent, now: float) -> None:
        try:
            match event:
                case Join():
                    self.membership.join(connection, event, now)
                case Closed():
                    self.membership.clear_up(connection, now)
                case Subscribe(stream=stream, every=every):
                    self.connections.subscribe(connection, stream, every)
                case Whisper():
                    self.connections.whisper(connection, event, now)
                case RemovePeer() | MutePeer() | BarIdentity():
                    self.membership.moderate(connection, event, now)
                case UpdateMetadata():
                    self.membership.update_metadata(connection, event, now)
        except RefusalError as error:
            self.connections.refuse(connection, error, now)


def _last_frames(messages: Sequence[bytes | str]) -> dict[int, int]:
    """Return the last sequence number of each stream in several messages."""
    last: dict[int, int] = {}
    for data in messages:
        if isinstance(data, bytes) and data[:1] == MEDIA_PREFIX:
            with suppress(RemoteProtocolError):  # that is seen when it is received
                last |= {stream: sequence for stream, sequence, _, _ in scan_frames(data)}
    return last
