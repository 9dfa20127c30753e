"""What goes from peer to peer: frames to all who want them, and whispers. Pure.

A relay that is late has more to do than it can: of several faces that one publisher sent since the
last turn of the event loop it then forwards the newest alone, and refuses newcomers (`Overload`).
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from pica_protocol.codec import encode_message
from pica_protocol.errors import CloseCode
from pica_protocol.frame_queue import QueuedFrame
from pica_protocol.frames import FrameSpan
from pica_protocol.messages import StreamMuted, Whisper
from pica_server.room.connections import WHISPER_COST, Connection, Connections
from pica_server.room.outbox import MAX_FRESH
from pica_server.room.room import EVERY_MOST, Room, Stream

LATE_S: Final = 0.1
"""A turn of the event loop that takes longer sheds faces (chosen: three faces; a shorter one may be
the machine's doing); two in a row are overload: newcomers are told to come later."""
PERIOD_S: Final = 0.05
"""Between two looks at the clock (chosen: half of what is late)."""
REMEMBERED_S: Final = 10.0
"""How long a stall counts (chosen: a health check each ten seconds sees every stall)."""
CALM_S: Final = 5.0
"""Without such a turn until newcomers are let in again (chosen)."""


class Overload:
    """Whether the relay has more to do than it can. Pure.

    Attributes:
        sheds: Whether the last turn of the event loop was so late that faces are shed.
    """

    def __init__(self) -> None:
        self.sheds = False
        self._late_s = 0.0
        self._refuses_until_s = float("-inf")
        self._worst_s, self._worst_until_s = 0.0, float("-inf")

    def note_turn(self, late_s: float, now: float) -> None:
        """Note how late the event loop has just been; one pause alone is no overload."""
        before_s, self._late_s = self._late_s, late_s
        self.sheds = late_s >= LATE_S
        if late_s >= self.worst_s(now):
            self._worst_s, self._worst_until_s = late_s, now + REMEMBERED_S
        if late_s >= LATE_S and before_s >= LATE_S:
            self._refuses_until_s = now + CALM_S

    def refuses(self, now: float) -> bool:
        """Whether newcomers are refused."""
        return now < self._refuses_until_s

    def worst_s(self, now: float) -> float:
        """Return by how much the event loop was late at worst; a stall counts for ten seconds."""
        return self._worst_s if now <= self._worst_until_s else 0.0


class Forwarding:
    """What passes through one relay."""

    def __init__(self, connections: Connections) -> None:
        self._connections = connections
        self._stats = connections.stats

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
        room, publisher, connections = connection.room, connection.peer_id, self._connections
        assert room is not None
        stats, ready, by_peer = self._stats, connections.ready, connections.by_peer
        streams = room.streams
        for number, sequence, start, end in spans:
            stream = streams.get(number)
            if stream is None or stream.publisher != publisher:
                reason = f"frame on stream {number}, which is not yours"
                connections.close(connection, CloseCode.FOREIGN_STREAM, reason, now)
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
            self._connections.ready.append(connection)

    def mute(self, room: Room, number: int, stream: Stream, *, is_muted: bool, now: float) -> None:
        """Stop a stream, or let it go on, and tell everybody here."""
        stream.is_muted, stream.newest = is_muted, None
        for receiver in self._connections.connected(room):
            if is_muted:
                num_dropped = receiver.outbox.drop(stream.publisher, number)
                self._connections.note_dropped(num_dropped, "muted")
            self._connections.send(receiver, StreamMuted(stream=number, is_muted=is_muted), now)

    def forget_peer(self, room: Room, peer_id: str) -> None:
        """Drop what waits of a peer that has left."""
        for receiver in self._connections.connected(room):
            self._connections.note_dropped(receiver.outbox.drop(peer_id), "departed")

    def whisper(self, connection: Connection, whisper: Whisper, now: float) -> None:
        """Pass a whisper on, under its sender's name, or drop it."""
        room, stats = connection.room, self._stats
        assert room is not None
        if not connection.told.take(now, WHISPER_COST):
            stats.whispers_dropped["rate"] += 1
            return
        connections = self._connections
        receiver = connections.by_peer.get(whisper.peer_id)
        if receiver is None or receiver is connection or receiver.room is not room:
            stats.whispers_dropped["absent"] += 1
            return
        message = encode_message(replace(whisper, peer_id=connection.peer_id))
        receiver.outbox.put_whisper(connection.peer_id, message, now)
        connections.ready.append(receiver)
        stats.whispers += 1
