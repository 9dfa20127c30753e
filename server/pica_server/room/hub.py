"""All that a relay decides, put together: what happens to whom. No socket, no clock.

The shell tells the hub what happened (``connect``, ``receive``, ``disconnect``, ``handle_timer``),
asks which connections have something to send (``take_ready``) and takes it from them one message at
a time (``take``, ``sent``). The parts decide:

    connections   the connections: how they begin and end, who is late, what is said to whom
    forwarding    frames and whispers, from peer to peer
    membership    rooms: who comes, goes, is away for a while and comes back
    Moderation    what admins ask for in their room

A connection is over when its ``closed`` is set; what it still has to send ends with a ``Bye``.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from pica_protocol.errors import CloseCode
from pica_protocol.frames import MEDIA_PREFIX
from pica_protocol.messages import (
    BarIdentity,
    Join,
    MutePeer,
    RemovePeer,
    Report,
    Subscribe,
    UpdateMetadata,
    Whisper,
)
from pica_protocol.session import Closed, ServerEvent
from pica_server.auth.tokens import Admission
from pica_server.config.relay import RelayConfig
from pica_server.room.connections import Connection, Connections
from pica_server.room.forwarding import Forwarding, Overload
from pica_server.room.membership import Membership
from pica_server.room.outbox import OutboundMessage
from pica_server.room.resume_tickets import ResumeTickets
from pica_server.room.room import BAR, Room
from pica_server.stats import RelayStats

BUSY_PERIOD_S: Final = 0.25
"""Time over which is counted how busy the event loop is (chosen)."""
TELLING_SHARE: Final = 0.5
"""The share of a drain's time in which all are told; the rest is left for them to go (chosen)."""


def departures(
    sizes: Sequence[int], *, per_s: float, burst: float, longest_s: float
) -> list[float]:
    """Return when each room is told, in seconds from the beginning of the drain.

    A room goes together, so that its people do not lose sight of each other for longer than they
    must. Rooms follow each other as fast as a relay with our own limits lets peers join, or as fast
    as the time allows.

    Args:
        sizes: How many peers each room has.
        per_s: Joins a second that the other relay takes; ``burst`` are those that it takes at once.
        longest_s: How long the drain may take.
    """
    offsets_s = []
    gone = 0
    for size in sizes:
        gone += size
        offsets_s.append(max(gone - burst, 0.0) / per_s)
    latest_s = TELLING_SHARE * longest_s
    last_s = max(offsets_s, default=0.0)
    scale = latest_s / last_s if last_s > latest_s else 1.0
    return [offset_s * scale for offset_s in offsets_s]


@dataclass(eq=False)
class Moderation:
    """Does what admins ask for in their rooms: remove a participant, mute a kind of stream, bar an
    identity.

    Only a participant whose token has the grant ``admin`` may ask. A participant who is not in the
    room any more is left alone: the request and the leaving have crossed.
    """

    _connections: Connections
    _membership: Membership
    _forwarding: Forwarding

    def receive(
        self, connection: Connection, asked: RemovePeer | MutePeer | BarIdentity, now: float
    ) -> None:
        """Do what a participant asks for, or close the connection if they may not."""
        room, refuse = connection.room, self._connections.refuse
        assert room is not None  # the session's table: only while joined
        if not connection.is_admin:
            reason = "your token does not let you moderate"
            refuse(connection, "admission", CloseCode.FORBIDDEN, reason, now)
            return
        if not connection.moderations.take(now):
            reason = "you moderate too often"
            refuse(connection, "moderation", CloseCode.TOO_FAST, reason, now)
            return
        match asked:
            case RemovePeer(peer_id=peer_id):
                self.remove(room, peer_id, now)
            case MutePeer(peer_id=peer_id, kind=kind, is_muted=is_muted):
                for track in room.peer(peer_id).tracks if peer_id in room else ():
                    if track.kind == kind:
                        self.mute(room, track.stream, is_muted=is_muted, now=now)
            case BarIdentity(identity=identity, is_barred=is_barred):
                self.bar(room, identity, is_barred=is_barred, now=now)

    def remove(self, room: Room, peer_id: str, now: float) -> None:
        """Remove a participant, who may be away."""
        if peer_id in room:
            reason = "an admin has removed you from the room"
            self._membership.close_peer(peer_id, CloseCode.REMOVED, reason, now)

    def bar(self, room: Room, identity: str, *, is_barred: bool, now: float) -> None:
        """Remove an identity from the room and keep it out until the room is empty, or let it join
        again."""
        room.decide(identity, BAR, holds=is_barred)
        peer_id = room.peer_of(identity)
        if is_barred and peer_id is not None:
            self.remove(room, peer_id, now)

    def mute(self, room: Room, number: int, *, is_muted: bool, now: float) -> None:
        """Stop a stream, or let it go on, and tell everybody. The decision holds for the identity
        of its publisher and for the kind of track."""
        stream = room.stream(number)
        if stream is None or stream.is_muted is is_muted:
            return
        peer = room.peer(stream.publisher)
        kind = next(track.kind for track in peer.tracks if track.stream == number)
        room.decide(peer.identity, kind, holds=is_muted)
        self._forwarding.mute(room, number, stream, is_muted=is_muted, now=now)


class Hub:
    """The relay without its sockets.

    Attributes:
        busy_ratio: How much of the time the event loop has worked lately, 0 to 1.
    """

    def __init__(
        self,
        config: RelayConfig,
        admit: Callable[[Join], Admission] | None = None,
        *,
        new_secret: Callable[[], str] | None = None,
    ) -> None:
        """Begin empty.

        Args:
            admit: Says what who joins may do, or raises `AdmissionError`; everybody may do
                everything by default.
            new_secret: Makes secrets to come back with; without it no place is kept.
        """
        self.stats = RelayStats()
        grace_s = 0.0 if new_secret is None else config.resume_grace_s
        self._tickets = ResumeTickets(grace_s, new_secret or str)
        self.connections = Connections(config, self.stats)
        self.overload = Overload()
        self.forwarding = Forwarding(self.connections)
        self.membership = Membership(
            self.connections,
            self.forwarding,
            self._tickets,
            admit or (lambda join: Admission()),
            self.overload,
        )
        self.moderation = Moderation(self.connections, self.membership, self.forwarding)
        self._config = config
        self._ready, self._timers = self.connections.ready, self.connections.timers
        self._load = (0.0, 0.0)
        self.busy_ratio = 0.0
        self._departures: deque[tuple[float, str]] = deque()

    @property
    def num_connections(self) -> int:
        """Connections that are not over yet."""
        return len(self.connections.by_peer)

    @property
    def num_rooms(self) -> int:
        """Rooms with peers in them."""
        return len(self.membership.rooms)

    def takes_rooms(self, now: float) -> bool:
        """Whether there is a place for rooms that are placed on this relay."""
        is_full = self.num_connections >= self._config.max_connections
        return not (is_full or self.connections.is_draining or self.overload.refuses(now))

    def room(self, name: str) -> Room | None:
        """Return a room, or None if no peer is in it here."""
        return self.membership.rooms.get(name)

    @property
    def num_waiting_frames(self) -> int:
        """Frames that wait for their receivers."""
        connections = self.connections.by_peer.values()
        return sum(each.outbox.waiting_frames for each in connections)

    @property
    def num_waiting_control_bytes(self) -> int:
        """Bytes of control messages that wait."""
        connections = self.connections.by_peer.values()
        return sum(each.outbox.waiting_control_bytes for each in connections)

    def note_turn(self, late_s: float, processor_s: float, now: float) -> None:
        """Note how late the event loop has just been, and what processor time it has used until
        now, in seconds."""
        before_s, since_s = self._load
        if now - since_s >= BUSY_PERIOD_S:
            self._load = (processor_s, now)
            self.busy_ratio = (processor_s - before_s) / (now - since_s)
        self.overload.note_turn(late_s, now)

    def connect(self, now: float, address: str = "") -> Connection:
        """Take a new websocket, see `Connections.connect`."""
        return self.connections.connect(now, address)

    def receive(self, connection: Connection, data: bytes | str, now: float) -> None:
        """Take one websocket message of a connection."""
        self.stats.bytes_in += len(data)
        if not connection.bytes_in.take(now, len(data)):
            self.connections.close_too_fast(connection, "bytes", now)
        elif not connection.messages_in.take(now):
            self.connections.close_too_fast(connection, "messages", now)
        if isinstance(data, bytes) and data[:1] == MEDIA_PREFIX:  # nearly always
            if spans := connection.session.receive_media(data):
                self.forwarding.forward(connection, data, spans, now)
            else:
                self.membership.clear_up(connection, now)
            return
        for event in connection.session.receive_data(data, now):
            self._handle(connection, event, now)
        self.connections.flush(connection, now)

    def shed(
        self, connection: Connection, messages: Sequence[bytes | str], now: float
    ) -> Sequence[bytes | str]:
        """Return those of several messages that a late relay looks at; the rest still counts
        against the limits of its sender."""
        kept = self.forwarding.shed(connection, messages)
        num_shed = len(messages) - len(kept)
        if num_shed and not connection.messages_in.take(now, num_shed):
            self.connections.close_too_fast(connection, "messages", now)
        return kept

    def disconnect(self, connection: Connection, code: int, reason: str, now: float) -> None:
        """Take note that a websocket has ended."""
        for event in connection.session.receive_close(code, reason, now):
            self._handle(connection, event, now)

    def close(self, connection: Connection, code: CloseCode, reason: str, now: float) -> None:
        """End a connection from this side; one that is lost, for good."""
        self.membership.close(connection, code, reason, now)

    def drain(self, now: float) -> None:
        """Begin to send everybody away: who has no room at once, the rooms one after the other.

        All that waits for them goes out before their goodbye. No peer is admitted any more.
        """
        config, connections = self._config, self.connections
        connections.is_draining = True
        roomless = [each for each in connections.by_peer.values() if each.room is None]
        connections.send_elsewhere(roomless, now)
        offsets_s = departures(
            [len(connections.connected(room)) for room in self.membership.rooms.values()],
            per_s=config.limits.joins_per_s,
            burst=config.limits.joins_burst,
            longest_s=config.drain_s,
        )
        rooms = zip(offsets_s, self.membership.rooms, strict=True)
        self._departures.extend((now + offset_s, name) for offset_s, name in rooms)
        self._send_rooms_away(now)

    def take_ready(self) -> list[Connection]:
        """Take the list of connections that have got something to send, or have closed."""
        taken = list(self._ready)
        self._ready.clear()
        return taken

    def take(self, connection: Connection, now: float) -> OutboundMessage | None:
        """Take the next message for a connection; the shell calls ``sent`` when it is out."""
        message = connection.outbox.take(now)
        if message is not None:
            connection.sending_since = now
        return message

    def is_sending(self, connection: Connection, now: float) -> None:
        """Take note that a socket did not take a message at once; ``sent`` follows when it has."""
        connection.sending_since = now
        connection.outbox.note_full(now)

    def sent(self, connection: Connection, message: OutboundMessage, now: float) -> None:
        """Take note that the socket took a message."""
        connection.sending_since = None
        connection.outbox.note_taken(len(message.data), now)
        self.stats.note_sent([message.data], message.received_s, now)

    def next_timer(self) -> float | None:
        """Return when ``handle_timer`` is due, or None."""
        timers = [line[0][0] for line in (self._timers, self._departures) if line]
        grace_ends_s = self._tickets.next_timer()
        if grace_ends_s is not None:
            timers.append(grace_ends_s)
        return min(timers, default=None)

    def handle_timer(self, now: float) -> None:
        """Close those who are late by now, and those whose turn to go has come."""
        self._send_rooms_away(now)
        self.membership.handle_timer(now)
        self.connections.handle_timer(now)

    def _send_rooms_away(self, now: float) -> None:
        while self._departures and self._departures[0][0] <= now:
            _, name = self._departures.popleft()
            placement = self.membership.placement
            if placement is None or not placement.hand_over(name):
                self.membership.send_elsewhere(name, [], "", now)

    def _handle(self, connection: Connection, event: ServerEvent, now: float) -> None:
        match event:
            case Join():
                self.membership.join(connection, event, now)
            case Closed():
                self.membership.clear_up(connection, now)
            case Report():
                self.stats.reported_lost += sum(stream.lost for stream in event.streams)
                self.stats.reported_concealed += sum(s.concealed for s in event.streams)
            case Subscribe(stream=stream, every=every):
                self.forwarding.subscribe(connection, stream, every)
            case Whisper():
                self.forwarding.whisper(connection, event, now)
            case RemovePeer() | MutePeer() | BarIdentity():
                self.moderation.receive(connection, event, now)
            case UpdateMetadata():
                self.membership.update_metadata(connection, event, now)
