"""All decisions of a relay: connections, rooms and what goes to whom. No socket, no clock.

The shell tells the hub what happened (``connect``, ``receive``, ``disconnect``, ``handle_timer``),
asks which connections have something to send (``take_ready``) and takes it from them one message at
a time (``take``, ``sent``). A connection is over when its ``closed`` is set; what it still has to
send ends with a ``Bye``.

Every connection stands once in the timer heap, with the next moment at which it could be late:
first with its handshake, then with reading what it was sent.

A peer of this node has a connection, or it is away: its connection broke, and its place is kept for
a while (see ``returns``). A connection that comes back to a place takes the id of the peer there.
"""

import heapq
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import count

from pica_protocol.codec import encode_message
from pica_protocol.errors import CloseCode
from pica_protocol.frames import FLAG_KEYFRAME
from pica_protocol.messages import (
    Join,
    Joined,
    KeyframeRequest,
    Message,
    Peer,
    PeerAway,
    PeerBack,
    PeerJoined,
    PeerLeft,
    PeerUpdated,
    Report,
    StreamMuted,
    UpdateMetadata,
    Want,
    Whisper,
)
from pica_protocol.session import Closed, Media, ServerEvent, ServerSession
from pica_protocol.stream_queue import Put
from pica_server.cluster_media import NodeLink
from pica_server.cluster_messages import Member
from pica_server.coalescing import Coalescing
from pica_server.config import RelayConfig
from pica_server.connection import Connection
from pica_server.drain import departures
from pica_server.errors import AdmissionError, OutboxFullError, RoomFullError
from pica_server.limits import TokenBucket
from pica_server.neighbours import Neighbours
from pica_server.notices import Notice
from pica_server.outbox import Outbox
from pica_server.returns import Returns
from pica_server.room import Room, Stream
from pica_server.shared_frames import Parcel
from pica_server.stats import RelayStats
from pica_server.tokens import Admission

SOFTWARE = "pica-relay"

_WAITS, _DROPPED = Put.WAITS, Put.DROPPED  # an enumeration's own lookup is slow
_KNOWN_CODES = frozenset(map(int, CloseCode))
MAX_BARRED = 256
"""Identities that a room remembers to keep out; drops the oldest (chosen)."""


class Hub:
    """The relay without its sockets.

    Attributes:
        stats: What it has done so far.
        neighbours: The other nodes of its cluster, or None.
        prefix: Begins the id of every peer; with a cluster it is different on each node.
    """

    def __init__(
        self,
        config: RelayConfig,
        admit: Callable[[Join], Admission] | None = None,
        *,
        new_secret: Callable[[], str] | None = None,
        notify: Callable[[Notice], None] | None = None,
    ) -> None:
        """Begin empty.

        Args:
            config: The limits.
            admit: Says what who joins may do, or raises `AdmissionError`; everybody may do
                everything by default.
            new_secret: Makes secrets to come back with; without it no place is kept.
            notify: Told at once what happens in rooms; it must neither block nor raise.
        """
        grace_s = 0.0 if new_secret is None else config.resume_grace_s
        self._returns = Returns(grace_s, new_secret or str)
        # The last connection of those who are away; as many as there are places kept.
        self._away: dict[str, Connection] = {}
        self._notify = notify or (lambda notice: None)
        self._admit = admit or (lambda join: Admission())
        self.stats = RelayStats()
        self.neighbours: Neighbours | None = None
        self.prefix = "p"
        self._config = config
        self._serials = count(1)
        self._connections: dict[str, Connection] = {}
        self._rooms: dict[str, Room] = {}
        self._ready: dict[Connection, None] = {}
        self._ready_links: dict[NodeLink, None] = {}
        self._coalescing = Coalescing(config.coalesce_above_busy, config.coalesce_longest_s)
        self._joins: TokenBucket | None = None  # full when the first one comes
        self._by_address: Counter[str] = Counter()  # bounded by the number of connections
        self._timers: list[tuple[float, int, Connection]] = []
        self._is_draining = False
        self._departures: deque[tuple[float, str]] = deque()

    @property
    def num_connections(self) -> int:
        """Connections that are not over yet."""
        return len(self._connections)

    @property
    def num_rooms(self) -> int:
        """Rooms with somebody in them."""
        return len(self._rooms)

    @property
    def rooms(self) -> Iterable[Room]:
        """Every room, to look at."""
        return self._rooms.values()

    def connection_of(self, peer_id: str) -> Connection | None:
        """Return the connection of a peer to look at, or None: it is away, elsewhere, or gone."""
        return self._connections.get(peer_id)

    @property
    def is_draining(self) -> bool:
        """Whether everybody is being sent away, and nobody let in."""
        return self._is_draining

    @property
    def num_waiting_frames(self) -> int:
        """Frames that wait for their receivers."""
        return sum(each.outbox.waiting_frames for each in self._connections.values())

    @property
    def num_waiting_control_bytes(self) -> int:
        """Bytes of control messages that wait."""
        return sum(each.outbox.waiting_control_bytes for each in self._connections.values())

    @property
    def coalescing_s(self) -> float:
        """How long frames may wait now for others to share a message with."""
        return self._coalescing.window_s

    @property
    def busy_ratio(self) -> float:
        """How much of the time the event loop has worked lately, 0 to 1."""
        return self._coalescing.busy_ratio

    def note_load(self, processor_s: float, now: float) -> None:
        """Note how much processor time the event loop has used until now; see `Coalescing`."""
        self._coalescing.note(processor_s, now)

    def connect(self, now: float, address: str = "") -> Connection:
        """Take a new websocket; it is closed at once when there are too many.

        Args:
            now: The time.
            address: Whose it is, see ``limits.address_group``; empty is not limited.
        """
        config, limits = self._config, self._config.limits
        session = ServerSession(software=SOFTWARE, now=now, timeout_s=config.handshake_timeout_s)
        outbox = Outbox(config.max_control_bytes, self.stats.dropped)
        connection = Connection(next(self._serials), session, outbox, limits, address, now)
        connection.peer_id = f"{self.prefix}{connection.serial}"
        self.stats.connections += 1
        is_full = len(self._connections) >= config.max_connections
        self._connections[connection.peer_id] = connection
        self._push_timer(connection, now)
        is_crowded = bool(address) and self._by_address[address] >= limits.connections_per_address
        if address:
            self._by_address[address] += 1
        if is_crowded:
            self.stats.limits_hit["address"] += 1
            reason = f"{limits.connections_per_address} connections from one address"
            self.close(connection, CloseCode.TOO_MANY, reason, now)
        elif self._is_draining:
            self._send_elsewhere([connection], now)
        elif is_full:
            self.stats.limits_hit["connections"] += 1
            self.close(connection, CloseCode.RELAY_FULL, "the relay is full", now)
        return connection

    def receive(self, connection: Connection, data: bytes | str, now: float) -> None:
        """Take one websocket message of a connection."""
        self.stats.bytes_in += len(data)
        if not connection.bytes_in.take(now, len(data)):
            self._close_too_fast(connection, "bytes", now)
        elif not connection.messages_in.take(now):
            self._close_too_fast(connection, "messages", now)
        for event in connection.session.receive_data(data, now):
            self._handle(connection, event, now)
        self._flush(connection, now)

    def disconnect(self, connection: Connection, code: int, reason: str, now: float) -> None:
        """Take note that a websocket has ended."""
        for event in connection.session.receive_close(code, reason, now):
            self._handle(connection, event, now)

    def close(self, connection: Connection, code: CloseCode, reason: str, now: float) -> None:
        """End a connection from this side; one that is lost, for good."""
        if connection.closed is None:
            connection.session.close(code, reason)
            self._finish(connection, now)
        elif self._away.get(connection.peer_id) is connection:
            self._give_up(connection.peer_id, "removed", now)

    def close_all(self, code: CloseCode, reason: str, now: float) -> None:
        """End every connection: the relay is stopping."""
        for connection in [*self._connections.values(), *self._away.values()]:
            self.close(connection, code, reason, now)

    def remove(self, room_name: str, peer_id: str, *, bar: bool, now: float) -> bool:
        """Put a peer out of its room.

        Args:
            room_name: The room.
            peer_id: The peer, who may be away.
            bar: Also keep its identity out as long as the room lasts.
            now: The time.

        Returns:
            Whether it was there, in a room that has peers on this node.
        """
        room = self._rooms.get(room_name)
        if room is None or peer_id not in room:
            return False
        if room.node_of(peer_id):
            if self.neighbours is not None:
                self.neighbours.order(room, "bar" if bar else "remove", peer_id)
            return True
        if bar:
            identity = room.identity_of(peer_id)
            room.bar(identity, MAX_BARRED)
            if self.neighbours is not None:
                self.neighbours.bar(room, identity)
        connection = self._connections.get(peer_id) or self._away[peer_id]
        self.close(connection, CloseCode.REMOVED, "an admin has removed you", now)
        return True

    def close_room(self, room_name: str, now: float, *, everywhere: bool = True) -> int | None:
        """Put everybody out of a room, on all nodes or on this one alone; return how many were on
        this one, or None: nobody was."""
        room = self._rooms.get(room_name)
        if room is None:
            return None
        if everywhere and self.neighbours is not None:
            self.neighbours.order(room, "close", "")
        num_peers = len(room)
        reason = "an admin has closed the room"
        self._send_away(self._connected(room), CloseCode.ROOM_CLOSED, reason, now)
        for peer_id in room.away_here:
            self._give_up(peer_id, "removed", now)
        return num_peers

    def mute(self, room_name: str, number: int, *, is_muted: bool, now: float) -> bool:
        """Stop a stream, or let it go on, and tell everybody; return whether it is there."""
        room = self._rooms.get(room_name)
        stream = None if room is None else room.stream(number)
        if room is None or stream is None:
            return False
        if stream.is_muted is is_muted:
            return True
        if room.is_remote(number):
            if self.neighbours is not None:
                self.neighbours.order(room, "mute" if is_muted else "unmute", str(number))
            return True
        self._mute(room, number, stream, is_muted=is_muted, now=now)
        if self.neighbours is not None:
            self.neighbours.note_member(room, stream.publisher)
        return True

    def _mute(self, room: Room, number: int, stream: Stream, *, is_muted: bool, now: float) -> None:
        stream.is_muted = is_muted
        room.forget_chain(number)
        if is_muted:
            for outbox in [link.outbox for link in room.links.values()]:
                self._drop(outbox.interrupt(number), "muted")
        for receiver in self._connected(room):
            if is_muted:
                self._drop(receiver.outbox.interrupt(number), "muted")
            self._send(receiver, StreamMuted(stream=number, is_muted=is_muted), now)
        if not is_muted and stream.deadline_s is None:
            stream.asked_s = None
            self.ask_for_keyframe(room, number, Put.KEYLESS.value, now)

    def drain(self, now: float) -> None:
        """Begin to send everybody away: who has no room at once, the rooms one after the other.

        All that waits for them goes out before their goodbye. Nobody is let in any more.
        """
        config = self._config
        self._is_draining = True
        roomless = [each for each in self._connections.values() if each.room is None]
        self._send_elsewhere(roomless, now)
        offsets_s = departures(
            [len(self._connected(room)) for room in self._rooms.values()],
            per_s=config.limits.joins_per_s,
            burst=config.limits.joins_burst,
            longest_s=config.drain_s,
        )
        rooms = zip(offsets_s, self._rooms, strict=True)
        self._departures.extend((now + offset_s, name) for offset_s, name in rooms)
        self._send_rooms_away(now)

    def take_ready(self) -> list[Connection]:
        """Take the list of connections that have got something to send, or have closed."""
        ready = list(self._ready)
        self._ready.clear()
        return ready

    def take(self, connection: Connection, now: float) -> Parcel | None:
        """Take the next message for a connection; the shell calls ``sent`` when it is out."""
        parcel = connection.outbox.take(now)
        if parcel is not None:
            connection.sending_since = now
        return parcel

    def is_sending(self, connection: Connection, now: float) -> None:
        """Take note that a socket did not take a message at once; ``sent`` follows when it has."""
        connection.sending_since = now

    def sent(self, connection: Connection, parcel: Parcel, now: float) -> None:
        """Take note that the socket took a message."""
        connection.sending_since = None
        self.all_sent([parcel], now)

    def all_sent(self, parcels: Sequence[Parcel], now: float) -> None:
        """Take note that the sockets took these messages."""
        # Once for every message that goes out: written for speed.
        num_bytes = num_frames = num_alike = 0
        last: Parcel | None = None
        for parcel in parcels:
            data, received_s = parcel
            num_bytes += len(data)
            num_frames += len(received_s)
            if parcel is not last:  # many get the very same
                if last is not None:
                    self._record_forwarding(last, num_alike, now)
                last, num_alike = parcel, 0
            num_alike += 1
        if last is not None:
            self._record_forwarding(last, num_alike, now)
        stats = self.stats
        stats.messages_out += len(parcels)
        stats.bytes_out += num_bytes
        stats.frames_out += num_frames

    def _record_forwarding(self, parcel: Parcel, num_receivers: int, now: float) -> None:
        record = self.stats.forwarding.record
        for moment_s in parcel.received_s:
            record(now - moment_s, num_receivers)

    def next_timer(self) -> float | None:
        """Return when ``handle_timer`` is due, or None."""
        timers = [line[0][0] for line in (self._timers, self._departures) if line]
        grace_ends_s = self._returns.next_timer()
        if grace_ends_s is not None:
            timers.append(grace_ends_s)
        return min(timers, default=None)

    def handle_timer(self, now: float) -> None:
        """Close those who are late by now, and those whose turn to go has come."""
        self._send_rooms_away(now)
        for peer_id in self._returns.take_expired(now):
            self._give_up(peer_id, "lost", now)
        while self._timers and self._timers[0][0] <= now:
            _, _, connection = heapq.heappop(self._timers)
            if connection.closed is not None:
                continue
            for event in connection.session.handle_timer(now):
                self._handle(connection, event, now)
            since = connection.sending_since
            stall_timeout_s = self._config.stall_timeout_s
            if since is not None and since + stall_timeout_s <= now:
                reason = f"nothing read for {stall_timeout_s:g} s"
                self.close(connection, CloseCode.TOO_SLOW, reason, now)
            if connection.closed is None:
                self._push_timer(connection, now)

    def _send_rooms_away(self, now: float) -> None:
        while self._departures and self._departures[0][0] <= now:
            _, name = self._departures.popleft()
            room = self._rooms.get(name)
            if room is not None:  # else it has emptied by itself
                self._send_elsewhere(self._connected(room), now)
                for peer_id in room.away_here:
                    self._give_up(peer_id, "lost", now)

    def _send_elsewhere(self, connections: list[Connection], now: float) -> None:
        reason, url = "the relay is stopping", self._config.drain_to
        self._send_away(connections, CloseCode.GOING_AWAY, reason, now, url)

    def _send_away(
        self, connections: list[Connection], code: CloseCode, reason: str, now: float, url: str = ""
    ) -> None:
        """Close some together: none of them is told how the others leave."""
        for connection in connections:
            connection.session.close(code, reason, url)
        for connection in connections:
            self._finish(connection, now)

    def _connected(self, room: Room) -> list[Connection]:
        """Return the connections of those in a room who are on this node and not away."""
        found = (self._connections.get(peer.peer_id) for peer in room.peers_here)
        return [connection for connection in found if connection is not None]

    def _push_timer(self, connection: Connection, now: float) -> None:
        deadline = connection.session.next_timer()
        if deadline is None:
            since = connection.sending_since
            deadline = (now if since is None else since) + self._config.stall_timeout_s
        heapq.heappush(self._timers, (deadline, connection.serial, connection))

    def _close_too_fast(self, connection: Connection, what: str, now: float) -> None:
        if connection.closed is None:
            self.stats.limits_hit[what] += 1
            limits = self._config.limits
            rate = limits.bytes_per_s if what == "bytes" else limits.messages_per_s
            reason = f"more than {rate:g} {what} a second"
            self.close(connection, CloseCode.TOO_FAST, reason, now)

    def _handle(self, connection: Connection, event: ServerEvent, now: float) -> None:
        match event:
            case Media():
                self._forward(connection, event, now)
            case Join():
                self._join(connection, event, now)
            case Closed():
                self._finish(connection, now)
            case Report():
                self.stats.reported_lost += sum(stream.lost for stream in event.streams)
                self.stats.reported_concealed += sum(s.concealed for s in event.streams)
            case Want(stream=stream, layer=layer):
                self._want(connection, stream, layer, now)
            case KeyframeRequest(stream=stream):
                assert connection.room is not None  # the session's table: only while joined
                self.ask_for_keyframe(connection.room, stream, "asked", now)
            case Whisper():
                self._whisper(connection, event, now)
            case UpdateMetadata():
                self._update_metadata(connection, event, now)

    def _update_metadata(self, connection: Connection, update: UpdateMetadata, now: float) -> None:
        room, metadata = connection.room, update.metadata
        assert room is not None
        if not connection.updates.take(now):
            self.stats.limits_hit["metadata"] += 1
            self.close(connection, CloseCode.TOO_FAST, "metadata changes too often", now)
        elif room.update_metadata(connection.peer_id, metadata):
            news = PeerUpdated(peer_id=connection.peer_id, metadata=metadata)
            self._tell_others(room, connection.peer_id, news, now)
            if self.neighbours is not None:
                self.neighbours.note_member(room, connection.peer_id)

    def _whisper(self, connection: Connection, whisper: Whisper, now: float) -> None:
        """Pass a whisper on, under its sender's name, or drop it."""
        room, stats = connection.room, self.stats
        assert room is not None
        if not connection.whispers.take(now):
            stats.whispers_dropped["rate"] += 1
            return
        if self.neighbours is not None and self.neighbours.whisper(
            room, connection.peer_id, whisper
        ):
            stats.whispers += 1
        elif whisper.peer_id != connection.peer_id:
            self.pass_whisper(room, connection.peer_id, whisper, now)
        else:
            stats.whispers_dropped["nobody"] += 1

    def pass_whisper(self, room: Room, sender: str, whisper: Whisper, now: float) -> None:
        """Pass a whisper to a peer that is connected here."""
        stats = self.stats
        receiver = self._connections.get(whisper.peer_id)
        if receiver is None or receiver.room is not room:
            stats.whispers_dropped["nobody"] += 1
            return
        # Whispers of many must not fill the queue that closes a peer for reading too slowly.
        if receiver.outbox.waiting_control_bytes > self._config.max_control_bytes // 4:
            stats.whispers_dropped["backlog"] += 1
            return
        self._send(receiver, replace(whisper, peer_id=sender), now)
        stats.whispers += 1

    def _forward(self, connection: Connection, media: Media, now: float) -> None:
        room = connection.room
        assert room is not None
        for span in media.spans:
            if not room.owns(connection.peer_id, span.stream):
                reason = f"frame on stream {span.stream}, which is not yours"
                self.close(connection, CloseCode.FOREIGN_STREAM, reason, now)
                return
        if len(media.spans) > 1 and not connection.messages_in.take(now, len(media.spans) - 1):
            self._close_too_fast(connection, "messages", now)
            return
        self.deliver(room, media, now)

    def deliver(self, room: Room, media: Media, now: float, *, num_here: int = 1) -> None:
        """Give frames to all who want them, here and on other nodes.

        Args:
            room: Where.
            media: The frames, of streams that are there.
            now: The time.
            num_here: Of the publisher: 1 if it is connected here, else 0.
        """
        needed: dict[tuple[int, Put], None] = {}
        connections, ready, stats = self._connections, self._ready, self.stats
        for number, layer, flags, start, end in media.spans:
            frame = media.message[start:end]
            is_keyframe = layer == 0 and bool(flags & FLAG_KEYFRAME)
            stream = room.stream(number)
            assert stream is not None  # its publisher is in the room
            receivers = room.receivers(number, layer)
            if stream.is_muted:
                stats.frames_in += 1
                stats.frames_in_by_layer[layer] += 1
                stats.dropped["muted"] += len(receivers)
                continue
            if layer == 0:
                stream.remember(frame, is_keyframe)
            if stream.deadline_s is not None:
                outboxes = [connections[peer_id].outbox for peer_id in receivers]
                for outbox in outboxes + [link.outbox for link in room.links.values()]:
                    outbox.open_ordered(number, stream.deadline_s)
            bundle = room.shared.current
            if bundle.is_full or bundle.carries(number):
                bundle = room.shared.turn_over()
            for peer_id in receivers:
                receiver = connections[peer_id]
                outbox = receiver.outbox
                if number in outbox.flowing:
                    if outbox.newest is bundle:
                        continue  # it is on the list already, or held for others
                    if outbox.share(bundle):
                        ready[receiver] = None
                        continue
                fate = outbox.put_frame(number, frame, layer, is_keyframe, now)
                if fate is not _DROPPED:
                    ready[receiver] = None
                    if fate is not _WAITS:
                        needed[number, fate] = None
            bundle.add(number, frame, layer, is_keyframe, now)
            for link in room.links.values():
                wanted = link.put_frame(number, frame, layer, is_keyframe, now)
                if wanted is not None and wanted is not _DROPPED:
                    self._ready_links[link] = None
                    if wanted is not _WAITS:
                        needed[number, wanted] = None
            stats.frames_in += 1
            stats.frames_in_by_layer[layer] += 1
            stats.unwanted += len(room) - num_here - len(receivers)
        for number, fate in needed:
            self.ask_for_keyframe(room, number, fate.value, now)

    def ask_for_keyframe(self, room: Room, stream: int, why: str, now: float) -> None:
        """Ask a publisher for a keyframe, unless it was asked a moment ago."""
        config = self._config
        is_slow = why == Put.BEHIND.value
        interval_s = config.slow_keyframe_interval_s if is_slow else config.keyframe_interval_s
        publisher = room.request_keyframe(stream, interval_s, now)
        if publisher is None:
            self.stats.keyframe_requests["withheld"] += 1
            return
        self.stats.keyframe_requests[why] += 1
        connection = self._connections.get(publisher)
        if connection is not None:
            self._send(connection, KeyframeRequest(stream=stream), now)
        elif self.neighbours is not None:
            self.neighbours.ask_for_keyframe(room, publisher, stream, why)

    def _want(self, connection: Connection, stream: int, layer: int | None, now: float) -> None:
        room = connection.room
        assert room is not None
        if room.stream(stream) is None:
            return  # it has just ended
        starts_again = room.want(connection.peer_id, stream, layer)
        self.stats.unwanted += connection.outbox.want(stream, layer)
        if self.neighbours is not None:
            self.neighbours.note_wishes(room)
        if starts_again:
            self._resume(connection, room, stream, now)

    def _resume(self, connection: Connection, room: Room, number: int, now: float) -> None:
        """Give a receiver what was kept of a stream; ask for what it lacks to decode the rest."""
        stream = room.stream(number)
        if stream is None or not stream.chain:
            return  # nothing to miss: it begins with a keyframe
        self.stats.frames_resumed += connection.outbox.resume(
            number, stream.chain, is_whole=stream.is_whole, now=now
        )
        self._ready[connection] = None
        if not stream.is_whole:
            self.ask_for_keyframe(room, number, Put.KEYLESS.value, now)

    def _join(self, connection: Connection, join: Join, now: float) -> None:
        config = self._config
        # First of all: who has no token must not use up the joins of those who have one.
        try:
            admission = self._admit(join)
        except AdmissionError as error:
            self.stats.limits_hit["admission"] += 1
            self.close(connection, error.code, str(error), now)
            return
        if self._joins is None:
            self._joins = TokenBucket(config.limits.joins_per_s, config.limits.joins_burst, now)
        if not self._joins.take(now):
            self.stats.limits_hit["joins"] += 1
            self.close(connection, CloseCode.BUSY, "too many join at once, try again", now)
            return
        connection.is_resumable = join.resumable
        if join.resume and self._come_back(connection, join, admission, now):
            return
        self._replace(join.room, admission.identity, now)
        former = self._rooms.get(join.room)
        if former is not None and former.is_barred(admission.identity):
            self.refuse_barred(connection, now)
            return
        if self.neighbours is not None:
            self.neighbours.join(connection, join, admission, now)
            return
        room = self._room(join.room)
        try:
            joined = room.join(
                connection.peer_id,
                admission.name or join.name,
                join.tracks,
                identity=admission.identity,
                may_subscribe=admission.may_subscribe,
                metadata=join.metadata,
            )
        except RoomFullError:
            self.refuse(connection, join.room, now)
            return
        self._enter(connection, room, joined, admission, now)

    def room(self, name: str) -> Room | None:
        """Return a room, or None if nobody is in it here."""
        return self._rooms.get(name)

    def enter(
        self, connection: Connection, name: str, peer: Peer, admission: Admission, now: float
    ) -> None:
        """Let somebody in for whom the nodes of the cluster have agreed on a place."""
        room = self._room(name)
        joined = room.enter(
            peer, identity=admission.identity, may_subscribe=admission.may_subscribe
        )
        self._enter(connection, room, joined, admission, now)

    def refuse(self, connection: Connection, name: str, now: float) -> None:
        """Close somebody for whom a room has no place."""
        self.stats.limits_hit["room"] += 1
        reason = f"room {name} is full: {self._config.room_capacity} peers"
        self.close(connection, CloseCode.ROOM_FULL, reason, now)

    def refuse_barred(self, connection: Connection, now: float) -> None:
        """Close somebody whom an admin keeps out."""
        self.stats.limits_hit["admission"] += 1
        self.close(connection, CloseCode.FORBIDDEN, "an admin has removed you", now)

    def follow(self, name: str, before: Member, member: Member, now: float) -> None:
        """Note what is different about a peer of another node, and tell who is here."""
        room, peer_id = self._rooms.get(name), member.peer.peer_id
        if room is None or not room.node_of(peer_id):
            return
        if room.update_metadata(peer_id, member.peer.metadata):
            news = PeerUpdated(peer_id=peer_id, metadata=member.peer.metadata)
            self._tell_others(room, peer_id, news, now)
        if member.is_away and not before.is_away:
            room.go_away(peer_id)
            self._tell_others(room, peer_id, PeerAway(peer_id=peer_id), now)
        elif before.is_away and not member.is_away:
            room.note_back(peer_id)
            self._tell_others(room, peer_id, PeerBack(peer_id=peer_id), now)
        for number in set(before.muted) ^ set(member.muted):
            stream = room.stream(number)
            if stream is not None and stream.publisher == peer_id:
                self._mute(room, number, stream, is_muted=number in member.muted, now=now)

    def arrive(self, name: str, node: str, peer: Peer, now: float) -> None:
        """Note a peer that came in on another node, and tell who is here."""
        room = self._room(name)
        self._rooms[name] = room
        room.arrive(peer, node)
        self._tell_others(room, peer.peer_id, PeerJoined(peer=peer), now)

    def depart(self, name: str, peer_id: str, reason: str, now: float) -> None:
        """Note that a peer has gone that was on another node, and tell who is here."""
        room = self._rooms.get(name)
        if room is not None and room.node_of(peer_id):
            self._forget(room, peer_id, reason, now)

    @property
    def has_ready_links(self) -> bool:
        """Whether something waits to go to another node."""
        return bool(self._ready_links)

    def ready_links(self) -> list[NodeLink]:
        """Return the links to other nodes with something to send."""
        return list(self._ready_links)

    def done_with(self, link: NodeLink) -> None:
        """Note that nothing waits in a link any more."""
        self._ready_links.pop(link, None)

    def drop_link(self, room: Room, node: str) -> None:
        """Forget another node that has left a room."""
        link = room.links.pop(node)
        self._ready_links.pop(link, None)

    def resume_link(self, room: Room, link: NodeLink, number: int, now: float) -> None:
        """Give another node what was kept of a stream that it begins to read."""
        stream = room.stream(number)
        if stream is None or not stream.chain:
            return
        link.outbox.resume(number, stream.chain, is_whole=stream.is_whole, now=now)
        self._ready_links[link] = None
        if not stream.is_whole:
            self.ask_for_keyframe(room, number, Put.KEYLESS.value, now)

    def _room(self, name: str) -> Room:
        room = self._rooms.get(name)
        return Room(name, self._config.room_capacity) if room is None else room

    def _enter(
        self,
        connection: Connection,
        room: Room,
        joined: Joined,
        admission: Admission,
        now: float,
    ) -> None:
        if len(room) == 1:
            self._notify(Notice(event="room_started", room=room.name))
        self._rooms[room.name] = room
        self.stats.joins += 1
        self._note(room, connection.peer_id, "peer_joined")
        self._accept(connection, room, joined, now)
        arrival = PeerJoined(peer=room.peer(connection.peer_id))
        self._tell_others(room, connection.peer_id, arrival, now)
        self._catch_up(connection, room, admission, now)

    def _come_back(
        self, connection: Connection, join: Join, admission: Admission, now: float
    ) -> bool:
        """Let somebody come back to their place, if it is still there and theirs."""
        peer_id = self._returns.redeem(join.room, join.resume)
        if peer_id is None:
            self.stats.resumes["unknown"] += 1
            return False
        room = self._rooms[join.room]
        lost = self._away.get(peer_id)
        former = self._connections[peer_id] if lost is None else lost
        if not room.is_place_of(peer_id, admission.identity, join.tracks):
            # Whoever has the secret does not come as who they were: nobody else will.
            self.stats.resumes["unfit"] += 1
            self.close(former, CloseCode.REPLACED, "your place was given up", now)
            return False
        self.stats.resumes["resumed"] += 1
        self._away.pop(peer_id, None)
        if lost is None:  # it is dead, and nobody has noticed yet
            former.room = None
            former.session.close(CloseCode.REPLACED, "you have come back on another connection")
            self._wind_up(former, now)
        del self._connections[connection.peer_id]
        connection.peer_id = peer_id
        self._connections[peer_id] = connection
        joined = room.come_back(peer_id, may_subscribe=admission.may_subscribe)
        if self.neighbours is not None:
            self.neighbours.come_back(connection, room)
        self._accept(connection, room, joined, now)
        self._tell_others(room, peer_id, PeerBack(peer_id=peer_id), now)
        if room.update_metadata(peer_id, join.metadata):
            news = PeerUpdated(peer_id=peer_id, metadata=join.metadata)
            self._tell_others(room, peer_id, news, now)
        if self.neighbours is not None:
            self.neighbours.note_member(room, peer_id)
        self._catch_up(connection, room, admission, now)
        return True

    def _accept(self, connection: Connection, room: Room, joined: Joined, now: float) -> None:
        """Tell somebody that they are in, and what else is so in the room."""
        connection.room = room
        if connection.is_resumable:
            secret = self._returns.issue(room.name, connection.peer_id)
            resume_ms = round(self._returns.grace_s * 1000)
            joined = replace(joined, resume=secret, resume_ms=resume_ms)
        connection.has_joined = True
        connection.outbox.shared = room.shared
        connection.session.accept(joined)
        self._flush(connection, now)
        for peer_id in room.away:
            self._send(connection, PeerAway(peer_id=peer_id), now)
        for number, stream in list(room.streams):
            if stream.is_muted:
                self._send(connection, StreamMuted(stream=number, is_muted=True), now)

    def _catch_up(
        self, connection: Connection, room: Room, admission: Admission, now: float
    ) -> None:
        for number, _ in list(room.streams):  # asking closes a publisher that does not read
            if connection.closed is None and admission.may_subscribe:
                self._resume(connection, room, number, now)

    def _replace(self, room_name: str, identity: str, now: float) -> None:
        """Close who is here under an identity that joins again: the newer one wins."""
        room = self._rooms.get(room_name)
        peer_id = None if room is None else room.peer_of(identity)
        if peer_id is not None:
            reason = "you have joined again from elsewhere"
            former = self._connections.get(peer_id) or self._away[peer_id]
            self.close(former, CloseCode.REPLACED, reason, now)

    def _finish(self, connection: Connection, now: float) -> None:
        """Clear up after a connection that is over: its last words, its place, the others' view."""
        if not self._wind_up(connection, now):
            return
        closed = connection.closed
        assert closed is not None
        room, peer_id, reason = connection.room, connection.peer_id, _farewell(closed)
        may_come_back = _is_loss(closed) and not self._is_draining
        if room is not None and may_come_back and self._returns.go_away(peer_id, now):
            self.stats.resumes["away"] += 1
            self._away[peer_id] = connection
            room.go_away(peer_id)
            if self.neighbours is not None:
                self.neighbours.note_member(room, peer_id)
            self._tell_others(room, peer_id, PeerAway(peer_id=peer_id), now)
            return
        self._depart(connection, reason, now)

    def _give_up(self, peer_id: str, reason: str, now: float) -> None:
        """Take somebody who is away out of the room."""
        self._depart(self._away.pop(peer_id), reason, now)

    def _depart(self, connection: Connection, reason: str, now: float) -> None:
        """Take somebody whose connection is over out of the room, if they are in one."""
        self._returns.forget(connection.peer_id)
        if self.neighbours is not None:
            self.neighbours.leave(connection, reason)
        room, connection.room = connection.room, None
        if room is not None:
            self._note(room, connection.peer_id, "peer_left", reason)
            self._forget(room, connection.peer_id, reason, now)

    def _wind_up(self, connection: Connection, now: float) -> bool:
        """Take a connection that is over out of the books, but not out of its room; return whether
        it was in them."""
        closed = connection.closed
        assert closed is not None
        if self._connections.get(connection.peer_id) is not connection:
            return False
        del self._connections[connection.peer_id]
        # A peer may name any code; each that is counted apart is a line of the metrics for ever.
        self.stats.closed[closed.code if closed.code in _KNOWN_CODES else 0] += 1
        if connection.address:
            self._by_address[connection.address] -= 1
            if self._by_address[connection.address] <= 0:
                del self._by_address[connection.address]
        last_words = connection.session.messages_to_send(now)
        self._drop(connection.outbox.finish(last_words), "departed")
        self._ready[connection] = None
        return True

    def _forget(self, room: Room, peer_id: str, reason: str, now: float) -> None:
        """Clear up after a member of a room, and tell the others."""
        peer = room.leave(peer_id)
        if len(room) == 0:
            for node in list(room.links):
                self.drop_link(room, node)
            del self._rooms[room.name]
            self._notify(Notice(event="room_ended", room=room.name))
            return
        for track in peer.tracks:
            for receiver in self._connected(room):
                self._drop(receiver.outbox.forget_stream(track.stream), "departed")
            for link in room.links.values():
                self._drop(link.forget_stream(track.stream), "departed")
        self._tell_others(room, peer_id, PeerLeft(peer_id=peer_id, reason=reason), now)

    def _note(self, room: Room, peer_id: str, event: str, reason: str = "") -> None:
        """Tell whoever keeps books about a peer of this node."""
        self._notify(
            Notice(
                event=event,
                room=room.name,
                peer_id=peer_id,
                identity=room.identity_of(peer_id),
                name=room.peer(peer_id).name,
                reason=reason,
            )
        )

    def _drop(self, num_frames: int, reason: str) -> None:
        if num_frames:
            self.stats.dropped[reason] += num_frames

    def _tell_others(self, room: Room, peer_id: str, message: Message, now: float) -> None:
        for other in room.peers_here:
            # Closing one that is full tells the rest, and so may close more: look again.
            connection = self._connections.get(other.peer_id)
            if connection is not None and other.peer_id != peer_id:
                self._send(connection, message, now)

    def _send(self, connection: Connection, message: Message, now: float) -> None:
        self._put_control(connection, encode_message(message), now)

    def _flush(self, connection: Connection, now: float) -> None:
        """Move what the session has to say into the outbox."""
        for data in connection.session.messages_to_send(now):
            self._put_control(connection, data, now)

    def _put_control(self, connection: Connection, data: bytes, now: float) -> None:
        if connection.closed is not None:
            return
        try:
            connection.outbox.put_control(data)
        except OutboxFullError as error:
            self.stats.limits_hit["control"] += 1
            self.close(connection, CloseCode.TOO_SLOW, str(error), now)
        self._ready[connection] = None


def _is_loss(closed: Closed) -> bool:
    """Say whether somebody is gone whom the network took, and who will try to come back."""
    lost = (CloseCode.CONNECTION_LOST, CloseCode.INTERNAL_ERROR)
    return closed.code == CloseCode.TOO_SLOW or (closed.is_remote and closed.code in lost)


def _farewell(closed: Closed) -> str:
    """Say why somebody is gone in a word the others may see."""
    if not closed.is_remote:
        return "removed"
    return "left" if closed.code == CloseCode.NORMAL else "lost"
