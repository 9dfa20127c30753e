"""Every connection of one relay: how it begins and ends, who is late, and what passes between them:
control messages, frames and whispers. Pure.

What a connection means to others, a place in a room above all, is not known here: the owner is
told by ``on_over`` when one is over. That is when its ``closed`` is set; what it still has to send
ends with a ``Bye``.

A relay that is late has more to do than it can: of several faces that one publisher sent since the
last turn of the event loop it then forwards the newest alone, and refuses newcomers (`Overload`).
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Any, Final

from pica_protocol.codec import encode_message
from pica_protocol.errors import CloseCode
from pica_protocol.frame_queue import QueuedFrame
from pica_protocol.frames import FrameSpan
from pica_protocol.messages import Message, StreamMuted, Whisper
from pica_protocol.session import Closed, ServerSession
from pica_server.config import RelayConfig
from pica_server.limits import TokenBucket
from pica_server.room.outbox import MAX_FRESH, Outbox
from pica_server.room.room import EVERY_MOST, Room, Stream
from pica_server.stats import RelayStats

MESSAGE_COST_BYTES: Final = 512
"""What each frame and each control message of a client counts beside its bytes (chosen: 300 frames
a second of the usual size use the limit up)."""
TOLD_PER_S: Final = 80.0
TOLD_AT_ONCE: Final = 640.0
WHISPER_COST: Final = 5
UPDATE_COST: Final = 64
MODERATION_COST: Final = 10
"""How much a client may have the relay tell others (chosen: two rounds of whispers to everybody in
the largest room at once, and then a round in four seconds, as keys change when a peer comes or
goes; ten updates of metadata at once, as people raise a hand; an admin may moderate everybody)."""
LATE_S: Final = 0.1
"""A turn of the event loop that takes longer sheds faces (chosen: three faces; a shorter one may be
the machine's doing); two in a row are overload: newcomers are told to come later."""
PERIOD_S: Final = 0.05
"""Between two looks at the clock (chosen: half of what is late)."""
CALM_S: Final = 5.0
"""Without such a turn until newcomers are let in again (chosen)."""

_KNOWN_CODES = frozenset(map(int, CloseCode))


class Overload:
    """Whether the relay has more to do than it can. Pure.

    Attributes:
        sheds: Whether the last turn of the event loop was so late that faces are shed.
    """

    def __init__(self) -> None:
        self.sheds = False
        self._late_s = 0.0
        self._refuses_until_s = float("-inf")

    def note_turn(self, late_s: float, now: float) -> None:
        """Note how late the event loop has just been; one pause alone is no overload."""
        before_s, self._late_s = self._late_s, late_s
        self.sheds = late_s >= LATE_S
        if late_s >= LATE_S and before_s >= LATE_S:
            self._refuses_until_s = now + CALM_S

    def refuses(self, now: float) -> bool:
        """Whether newcomers are refused."""
        return now < self._refuses_until_s


@dataclass(eq=False, slots=True)
class Connection:
    """One websocket as the hub sees it; the shell reads ``closed``."""

    serial: int
    session: ServerSession
    outbox: Outbox
    address: str
    peer_id: str
    bytes_in: TokenBucket
    told: TokenBucket
    """What it has the relay tell others, see `TOLD_PER_S`."""
    has_joined: bool = False
    room: Room | None = None
    late_s: float = math.inf
    """When it has not read for too long what it was sent."""
    away_until_s: float = math.inf
    """When its place is given up, after the connection was lost."""
    ticket: bytes = b""
    """Hash of the secret to come back with; empty: its place is not kept."""
    is_crowded: bool = False
    """One more than its address may have."""
    is_resumable: bool = False
    is_admin: bool = False
    """Whether its token has the grant ``admin``."""
    peer: Any = None
    """What the shell keeps of it."""

    @property
    def closed(self) -> Closed | None:
        """How it ended, or None."""
        return self.session.closed


class Connections:
    """The connections of one relay.

    Attributes:
        by_peer: Those that are not over, by the id of their peer; to be read only.
        ready: Those that have got something to send, or have closed; some more than once.
        on_over: Told of every connection that is over, once or more, to clear up after it; it
            begins with ``wind_up``.
        is_draining: All peers are being sent away, and none admitted.
    """

    def __init__(self, config: RelayConfig, stats: RelayStats) -> None:
        self.config = config
        self.stats = stats
        self.by_peer: dict[str, Connection] = {}
        self.ready: list[Connection] = []
        self.on_over: Callable[[Connection, float], None] = lambda connection, now: None
        self.is_draining = False
        self._serials = count(1)
        self._by_address: Counter[str] = Counter()  # bounded by the number of connections

    def connect(self, now: float, address: str = "") -> Connection:
        """Take a new websocket; it is closed at once when there are too many of everybody.

        One too many of its address is closed when it joins, unless it comes back to a place: whose
        that was may be dead without anybody having noticed.

        Args:
            address: Whose it is, see ``proxies.address_group``; empty is not limited.
        """
        config, limits = self.config, self.config.limits
        session = ServerSession(now=now, timeout_s=config.handshake_timeout_s)
        outbox = Outbox(self.stats.dropped)
        serial = next(self._serials)
        peer_id = f"p{serial}"
        # What piled up while the relay or the way to it stood still was sent at a good rate: who
        # has been here for so long may send that much at once. Who has just come has saved nothing.
        rate = limits.bytes_per_s
        bytes_in = TokenBucket(rate, rate * limits.burst_s, now, level=rate)
        told = TokenBucket(TOLD_PER_S, TOLD_AT_ONCE, now)
        connection = Connection(serial, session, outbox, address, peer_id, bytes_in, told)
        self.stats.connections += 1
        is_full = len(self.by_peer) >= config.max_connections
        self.by_peer[peer_id] = connection
        if address:
            self._by_address[address] += 1
            connection.is_crowded = self._by_address[address] > limits.connections_per_address
        if self.is_draining:
            self.send_elsewhere([connection], now)
        elif is_full:
            reason = "the relay is full"
            self.refuse(connection, "connections", CloseCode.RELAY_FULL, reason, now)
        return connection

    def rename(self, connection: Connection, peer_id: str) -> None:
        """Give a connection the id of a peer whose own is over."""
        del self.by_peer[connection.peer_id]
        connection.peer_id = peer_id
        self.by_peer[peer_id] = connection

    def connected(self, room: Room) -> list[Connection]:
        """Return the connections of those in a room who are not away."""
        found = (self.by_peer.get(peer.peer_id) for peer in room.peers)
        return [connection for connection in found if connection is not None]

    def close(self, connection: Connection, code: CloseCode, reason: str, now: float) -> None:
        """End a connection from this side, unless it is over."""
        if connection.closed is None:
            connection.session.close(code, reason)
            self.on_over(connection, now)

    def close_together(
        self,
        connections: Sequence[Connection],
        code: CloseCode,
        reason: str,
        now: float,
        url: str = "",
    ) -> None:
        """Close some so that none of them is told how the others leave."""
        for connection in connections:
            connection.session.close(code, reason, url)
        for connection in connections:
            self.on_over(connection, now)

    def refuse(
        self, connection: Connection, limit: str, code: CloseCode, reason: str, now: float
    ) -> None:
        """Close who has reached a limit, and count it, unless it is over."""
        if connection.closed is None:
            self.stats.limits_hit[limit] += 1
            self.close(connection, code, reason, now)

    def close_too_fast(self, connection: Connection, now: float) -> None:
        """Close who sends more than a client may."""
        limit = f"{self.config.limits.bytes_per_s:g} bytes"
        reason = f"more than {limit} a second, with {MESSAGE_COST_BYTES} for each message"
        self.refuse(connection, "bytes", CloseCode.TOO_FAST, reason, now)

    def send_elsewhere(self, connections: Sequence[Connection], now: float, url: str = "") -> None:
        """Redirect some: to a relay that has their room, or because this one is stopping."""
        reason = "the room is on another relay" if url else "the relay is stopping"
        url = url or self.config.drain_to
        self.close_together(connections, CloseCode.GOING_AWAY, reason, now, url)

    def wind_up(self, connection: Connection, now: float) -> bool:
        """Take a connection that is over out of the books; return whether it was in them."""
        closed = connection.closed
        assert closed is not None
        if self.by_peer.get(connection.peer_id) is not connection:
            return False
        del self.by_peer[connection.peer_id]
        # A peer may name any code; each that is counted apart is a line of the metrics for ever.
        self.stats.closed[closed.code if closed.code in _KNOWN_CODES else 0] += 1
        if connection.address:
            self._by_address[connection.address] -= 1
            if self._by_address[connection.address] <= 0:
                del self._by_address[connection.address]
        last_words = connection.session.messages_to_send(now)
        self.note_dropped(connection.outbox.finish(last_words), "departed")
        self.ready.append(connection)
        return True

    def note_dropped(self, num_frames: int, reason: str) -> None:
        """Count frames that did not reach their receiver, if there are any."""
        if num_frames:
            self.stats.dropped[reason] += num_frames

    def handle_timer(self, now: float) -> None:
        """Close those who are late by now."""
        for connection in list(self.by_peer.values()):
            if connection.room is None and connection.session.handle_timer(now):
                self.on_over(connection, now)
            if connection.late_s <= now:
                reason = f"nothing read for {self.config.stall_timeout_s:g} s"
                self.close(connection, CloseCode.TOO_SLOW, reason, now)

    def tell_others(self, room: Room, peer_id: str, message: Message, now: float) -> None:
        """Tell something to everybody in a room, but not to one of them."""
        for other in room.peers:
            # Closing one that is full tells the rest, and so may close more: look again.
            connection = self.by_peer.get(other.peer_id)
            if connection is not None and other.peer_id != peer_id:
                self.send(connection, message, now)

    def send(self, connection: Connection, message: Message, now: float) -> None:
        """Queue a control message; who has let too many pile up is closed instead."""
        self._put_control(connection, encode_message(message), now)

    def flush(self, connection: Connection, now: float) -> None:
        """Move what the session has to say into the outbox."""
        for data in connection.session.messages_to_send(now):
            self._put_control(connection, data, now)

    def _put_control(self, connection: Connection, data: bytes, now: float) -> None:
        if connection.closed is not None:
            return
        if not connection.outbox.put_control(data):
            reason = f"{connection.outbox.waiting_control_bytes} bytes of control messages wait"
            self.refuse(connection, "control", CloseCode.TOO_SLOW, reason, now)
        self.ready.append(connection)

    def forward(
        self,
        connection: Connection,
        message: bytes,
        spans: list[FrameSpan],
        now: float,
        last: Mapping[int, int] | None = None,
    ) -> None:
        """Take the frames of a message from their publisher, who is in a room.

        Args:
            last: The sequence number of the last frame of each stream that has come; older faces
                are left out. None: all are passed on.
        """
        # Once for every frame that comes: written for speed.
        room, publisher = connection.room, connection.peer_id
        assert room is not None
        stats, ready, by_peer = self.stats, self.ready, self.by_peer
        streams = room.streams
        for number, sequence, start, end in spans:
            stream = streams.get(number)
            if stream is None or stream.publisher != publisher:
                reason = f"frame on stream {number}, which is not yours"
                self.close(connection, CloseCode.FOREIGN_STREAM, reason, now)
                return
            if last and stream.deadline_s is None and last[number] != sequence:
                stats.dropped["late"] += len(room) - 1
                continue
            stats.frames_in += 1
            known = stream.receivers
            receivers = None if known is None else known[sequence % EVERY_MOST]
            if receivers is None:
                receivers = room.receivers(stream, sequence, by_peer)
            if stream.is_muted:
                stats.dropped["muted"] += len(receivers)
                continue
            frame = QueuedFrame(publisher, number, message[start:end], now, stream.deadline_s)
            if stream.deadline_s is None:
                stream.newest = frame
            for receiver in receivers:
                outbox = receiver.outbox
                fresh = outbox.fresh
                if not fresh:
                    ready.append(receiver)
                    fresh.append(frame)
                    continue
                fresh.append(frame)
                if not outbox.is_quick:
                    ready.append(receiver)
                if len(fresh) > MAX_FRESH:
                    outbox.sort()

    def subscribe(self, connection: Connection, number: int, every: int) -> None:
        """Follow a receiver's subscription; who begins to want a stream gets its newest frame."""
        room = connection.room
        assert room is not None
        stream = room.streams.get(number)
        if room.subscribe(connection.peer_id, number, every) and stream is not None:
            self._send_newest(connection, stream)
        elif every == 0 and stream is not None:
            connection.outbox.drop(stream.publisher, number)

    def catch_up(self, connection: Connection, room: Room) -> None:
        """Give a receiver who comes, or comes back, the newest frame of every stream."""
        for stream in room.streams.values():
            self._send_newest(connection, stream)

    def _send_newest(self, connection: Connection, stream: Stream) -> None:
        if stream.newest is not None and stream.publisher != connection.peer_id:
            connection.outbox.put(stream.newest)
            self.ready.append(connection)

    def mute(self, room: Room, number: int, stream: Stream, *, is_muted: bool, now: float) -> None:
        """Stop a stream, or let it go on, and tell everybody here."""
        stream.is_muted, stream.newest = is_muted, None
        for receiver in self.connected(room):
            if is_muted:
                num_dropped = receiver.outbox.drop(stream.publisher, number)
                self.note_dropped(num_dropped, "muted")
            self.send(receiver, StreamMuted(stream=number, is_muted=is_muted), now)

    def forget_peer(self, room: Room, peer_id: str) -> None:
        """Drop what waits of a peer that has left."""
        for receiver in self.connected(room):
            self.note_dropped(receiver.outbox.drop(peer_id), "departed")

    def whisper(self, connection: Connection, whisper: Whisper, now: float) -> None:
        """Pass a whisper on, under its sender's name, or drop it."""
        room, stats = connection.room, self.stats
        assert room is not None
        if not connection.told.take(now, WHISPER_COST):
            stats.whispers_dropped["rate"] += 1
            return
        receiver = self.by_peer.get(whisper.peer_id)
        if receiver is None or receiver is connection or receiver.room is not room:
            stats.whispers_dropped["absent"] += 1
            return
        message = encode_message(replace(whisper, peer_id=connection.peer_id))
        receiver.outbox.put_whisper(connection.peer_id, message, now)
        self.ready.append(receiver)
        stats.whispers += 1
