"""Every connection of one relay: how it begins and ends, who is late, and what passes between them:
control messages, frames and whispers. Pure.

What the end of a connection means to others is not known here: `Membership` is told by ``on_over``.

A relay that is late has more to do than it can: of several faces that one publisher sent since the
last turn of the event loop it then forwards the newest alone, and refuses newcomers (`Overload`).
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import count
from typing import Final

from pica_protocol.codec import encode_message
from pica_protocol.errors import CloseCode
from pica_protocol.frame_queue import QueuedFrame
from pica_protocol.frames import FrameSpan
from pica_protocol.messages import Message, StreamMuted, Whisper
from pica_protocol.session import ServerSession
from pica_server.config import RelayConfig
from pica_server.limits import RefusalError, TokenBucket
from pica_server.room.outbox import MAX_FRESH, Outbox
from pica_server.room.room import EVERY_MOST, Connection, Room, Stream
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
WORKED_SHARE: Final = 0.5
"""Part of a late turn that the relay must have worked itself: else others keep it from the
processor, as on a machine where a call begins, and newcomers are not what is too much (chosen)."""
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

    def note_turn(self, late_s: float, now: float, worked: float = 1.0) -> None:
        """Note how late the event loop has just been, and which part of that time the process has
        worked; one pause alone is no overload."""
        before_s, self._late_s = self._late_s, late_s
        self.sheds = late_s >= LATE_S
        if late_s >= LATE_S and before_s >= LATE_S and worked >= WORKED_SHARE:
            self._refuses_until_s = now + CALM_S

    def refuses(self, now: float) -> bool:
        """Whether newcomers are refused."""
        return now < self._refuses_until_s


class Connections:
    """The connections of one relay.

    Attributes:
        open: Those that are not over, in the order of their coming; to be read only.
        ready: Those that have got something to send, or have closed; some more than once.
        on_over: Told of every connection that is over, once or more, to clear up after it; it
            begins with ``wind_up``.
        is_draining: All peers are being sent away, and none admitted.
    """

    def __init__(self, config: RelayConfig, stats: RelayStats) -> None:
        self.config = config
        self.stats = stats
        self.open: dict[Connection, None] = {}
        self.ready: list[Connection] = []
        self.on_over: Callable[[Connection, float], None] = lambda connection, now: None
        self.is_draining = False
        self._serials = count(1)
        self._by_address: Counter[str] = Counter()  # bounded by the number of connections

    @property
    def is_full(self) -> bool:
        """Whether there are as many as there may be."""
        return len(self.open) >= self.config.max_connections

    def connect(self, now: float, address: str = "") -> Connection:
        """Take a new websocket; it is closed at once when there are too many of everybody.

        One too many of its address is closed when it joins, unless it comes back to a place: whose
        that was may be dead without anybody having noticed.

        Args:
            address: Whose it is, see ``limits.address_group``; empty is not limited.
        """
        config, limits = self.config, self.config.limits
        serial, rate = next(self._serials), limits.bytes_per_s
        connection = Connection(
            serial=serial,
            session=ServerSession(now=now, timeout_s=config.handshake_timeout_s),
            outbox=Outbox(self.stats.dropped),
            address=address,
            # What piled up while the relay or the way to it stood still was sent at a good rate:
            # a connection this old may send it at once. A newcomer has saved nothing.
            bytes_in=TokenBucket(rate, rate * limits.burst_s, now, level=rate),
            told=TokenBucket(TOLD_PER_S, TOLD_AT_ONCE, now),
            peer_id=f"p{serial}",
        )
        self.stats.connections += 1
        is_full = self.is_full
        self.open[connection] = None
        if address:
            self._by_address[address] += 1
            connection.is_crowded = self._by_address[address] > limits.connections_per_address
        if self.is_draining:
            self.send_elsewhere([connection], now)
        elif is_full:
            full = RefusalError("the relay is full", CloseCode.RELAY_FULL, "connections")
            self.refuse(connection, full, now)
        return connection

    def close(self, connection: Connection, code: CloseCode, reason: str, now: float) -> None:
        """End a connection from this side, unless it is over."""
        if connection.closed is None:
            connection.session.close(code, reason)
            self.on_over(connection, now)

    def refuse(self, connection: Connection, why: RefusalError, now: float) -> None:
        """Close who has reached a limit, and count it, unless it is over."""
        if connection.closed is None:
            self.stats.limits_hit[why.limit] += 1
            self.close(connection, why.code, str(why), now)

    def close_too_fast(self, connection: Connection, now: float) -> None:
        """Close who sends more than a client may."""
        limit = f"{self.config.limits.bytes_per_s:g} bytes"
        reason = f"more than {limit} a second, with {MESSAGE_COST_BYTES} for each message"
        self.refuse(connection, RefusalError(reason, CloseCode.TOO_FAST, "bytes"), now)

    def send_elsewhere(self, connections: Sequence[Connection], now: float, url: str = "") -> None:
        """Redirect some, to a relay that has their room, or because this one is stopping; none of
        them is told how the others leave."""
        reason = "the room is on another relay" if url else "the relay is stopping"
        for connection in connections:
            connection.session.close(CloseCode.GOING_AWAY, reason, url or self.config.drain_to)
        for connection in connections:
            self.on_over(connection, now)

    def wind_up(self, connection: Connection, now: float) -> bool:
        """Take a connection that is over out of the books; return whether it was in them."""
        closed = connection.closed
        assert closed is not None
        if connection not in self.open:
            return False
        del self.open[connection]
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
        for connection in list(self.open):
            if connection.room is None and connection.session.handle_timer(now):
                self.on_over(connection, now)
            if connection.late_s <= now:
                reason = f"nothing read for {self.config.stall_timeout_s:g} s"
                self.close(connection, CloseCode.TOO_SLOW, reason, now)

    def tell_others(self, room: Room, member: Connection, message: Message, now: float) -> None:
        """Tell something to everybody in a room, but not to one of them."""
        data = encode_message(message)
        # Closing one that is full tells the rest, and so may close more.
        for other in list(room.members.values()):
            if other is not member:
                self._put_control(other, data, now)

    def send(self, connection: Connection, message: Message, now: float) -> None:
        """Queue a control message; close a connection on which too many have piled up."""
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
            self.refuse(connection, RefusalError(reason, CloseCode.TOO_SLOW, "control"), now)
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
        stats, ready, streams = self.stats, self.ready, room.streams
        for number, sequence, start, end in spans:
            stream = streams.get(number)
            if stream is None or stream.publisher != publisher:
                reason = f"frame on stream {number}, which is not yours"
                self.close(connection, CloseCode.FOREIGN_STREAM, reason, now)
                return
            if last and stream.deadline_s is None and last[number] != sequence:
                stats.dropped["late"] += len(room.members) - 1
                continue
            stats.frames_in += 1
            known = stream.receivers
            receivers = None if known is None else known[sequence % EVERY_MOST]
            if receivers is None:
                receivers = room.receivers(stream, sequence)
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

    def subscribe(self, member: Connection, number: int, every: int) -> None:
        """Follow a receiver's subscription; a new subscriber gets the newest frame."""
        assert member.room is not None
        stream = member.room.streams.get(number)
        if stream is None:
            return
        if member.room.subscribe(member, number, every):
            self.send_newest(member, stream)
        elif every == 0:
            member.outbox.drop(stream.publisher, number)

    def send_newest(self, member: Connection, stream: Stream) -> None:
        """Give a receiver the newest frame of a stream."""
        if stream.newest is not None and stream.publisher != member.peer_id:
            member.outbox.put(stream.newest)
            self.ready.append(member)

    def mute(self, room: Room, stream: Stream, *, is_muted: bool, now: float) -> None:
        """Stop a stream, or let it go on, and tell everybody here."""
        stream.is_muted, stream.newest = is_muted, None
        for member in room.connected:
            if is_muted:
                num_dropped = member.outbox.drop(stream.publisher, stream.number)
                self.note_dropped(num_dropped, "muted")
            self.send(member, StreamMuted(stream=stream.number, is_muted=is_muted), now)

    def whisper(self, member: Connection, whisper: Whisper, now: float) -> None:
        """Pass a whisper on, under its sender's name, or drop it."""
        assert member.room is not None
        if not member.told.take(now, WHISPER_COST):
            self.stats.whispers_dropped["rate"] += 1
            return
        receiver = member.room.members.get(whisper.peer_id)
        if receiver is None or receiver is member or receiver.closed is not None:
            self.stats.whispers_dropped["absent"] += 1
            return
        message = encode_message(replace(whisper, peer_id=member.peer_id))
        receiver.outbox.put_whisper(member.peer_id, message, now)
        self.ready.append(receiver)
        self.stats.whispers += 1
