"""What goes from peer to peer: frames to all who want them, keyframes asked for, whispers. Pure."""

from dataclasses import replace
from typing import Final

from pica_protocol.errors import CloseCode, RemoteProtocolError
from pica_protocol.frames import FLAG_KEYFRAME, HEADER_BYTES, MEDIA_KIND, scan_frames
from pica_protocol.limits import MAX_LAYER
from pica_protocol.messages import KeyframeRequest, StreamMuted, Whisper
from pica_protocol.session import Media
from pica_protocol.stream_queue import Put
from pica_server.room.connection import Connection
from pica_server.room.connections import Connections
from pica_server.room.outbox import ArrivedFrame
from pica_server.room.room import Room, Stream

_WAITS, _DROPPED = Put.WAITS, Put.DROPPED  # an enumeration's own lookup is slow

NOTHING_DECODABLE: Final = -1
"""Stands for no layer as the highest that can be decoded: a keyframe must come first."""


class Forwarding:
    """What passes through one relay."""

    def __init__(self, connections: Connections) -> None:
        self._connections = connections
        self._stats = connections.stats

    def forward(self, connection: Connection, media: Media, now: float) -> None:
        """Take frames from their publisher, who is in a room."""
        room = connection.room
        assert room is not None
        for span in media.spans:
            if not room.owns(connection.peer_id, span.stream):
                reason = f"frame on stream {span.stream}, which is not yours"
                self._connections.close(connection, CloseCode.FOREIGN_STREAM, reason, now)
                return
        if len(media.spans) > 1 and not connection.messages_in.take(now, len(media.spans) - 1):
            self._connections.close_too_fast(connection, "messages", now)
            return
        self._deliver(room, media, now)

    def _deliver(self, room: Room, media: Media, now: float) -> None:
        """Give frames of streams that are there to all who want them."""
        needed: dict[tuple[int, Put], None] = {}
        connections, stats = self._connections, self._stats
        by_peer = connections.by_peer
        highest_layer = connections.brake.highest_layer
        for number, layer, flags, start, end in media.spans:
            stream = room.stream(number)
            assert stream is not None  # its publisher is in the room
            receivers, ready = room.receivers(number, layer), connections.ready
            if stream.is_muted:
                stats.frames_in += 1
                stats.frames_in_by_layer[layer] += 1
                stats.dropped["muted"] += len(receivers)
                continue
            if (
                layer > highest_layer or stream.decodable_layer < MAX_LAYER
            ) and self._is_dropped_late(room, number, stream, layer, flags, now):
                continue
            frame = ArrivedFrame(number, media.message[start:end], layer, flags, now)
            if layer == 0:
                stream.remember(frame.data, frame.is_keyframe)
            if stream.deadline_s is not None:
                ready = connections.first
                for peer_id in receivers:
                    by_peer[peer_id].outbox.open_ordered(number, stream.deadline_s)
            for peer_id in receivers:
                receiver = by_peer[peer_id]
                fate = receiver.outbox.put(frame)
                if fate is not _DROPPED:
                    ready[receiver] = None
                    if fate is not _WAITS:
                        needed[number, fate] = None
            stats.frames_in += 1
            stats.frames_in_by_layer[layer] += 1
            stats.unwanted += len(room) - 1 - len(receivers)
        for number, fate in needed:
            self.ask_for_keyframe(room, number, fate.value, now)

    def drop_late(self, connection: Connection, data: bytes | str, now: float) -> bool:
        """Drop a message if it is one frame that the brake lets nobody have; return whether it is.

        It was not looked at before, and costs little: that is the point.
        """
        room, size = connection.room, len(data)
        if room is None or isinstance(data, str) or size <= HEADER_BYTES or data[0] != MEDIA_KIND:
            return False
        number, layer, flags = int.from_bytes(data[1:3], "big"), data[5], data[6]
        is_alone = size == 1 + HEADER_BYTES + int.from_bytes(data[7:9], "big")
        if not is_alone or layer > MAX_LAYER or not room.owns(connection.peer_id, number):
            return False
        stream = room.stream(number)
        assert stream is not None  # it is theirs
        return self._is_dropped_late(room, number, stream, layer, flags, now)

    @staticmethod
    def may_gather(room: Room, data: bytes) -> bool:
        """Say whether a message holds frames alone, none of them of a voice, so that it may wait
        for others of its room."""
        try:
            spans = scan_frames(data)
        except RemoteProtocolError:  # so its session will say
            return False
        for span in spans:
            stream = room.stream(span.stream)
            if stream is None or stream.deadline_s is not None:
                return False
        return True

    def _is_dropped_late(
        self, room: Room, number: int, stream: Stream, layer: int, flags: int, now: float
    ) -> bool:
        """Say whether the brake drops a frame, or has dropped what it refers to; count it."""
        is_keyframe = layer == 0 and bool(flags & FLAG_KEYFRAME)
        highest_layer = min(self._connections.brake.highest_layer, stream.decodable_layer)
        is_kept = is_keyframe or stream.is_muted or stream.deadline_s is not None
        if is_kept or layer <= highest_layer:
            stream.decodable_layer = MAX_LAYER
            return False
        stream.decodable_layer = min(layer or NOTHING_DECODABLE, stream.decodable_layer)
        stats = self._stats
        stats.frames_in += 1
        stats.frames_in_by_layer[layer] += 1
        stats.dropped["late"] += len(room.receivers(number, layer))
        if layer == 0:
            self.ask_for_keyframe(room, number, Put.BEHIND.value, now)
        return True

    def want(self, connection: Connection, stream: int, layer: int | None, now: float) -> None:
        """Follow a receiver's layer subscription."""
        room = connection.room
        assert room is not None
        if room.stream(stream) is None:
            return  # it has just ended
        starts_again = room.want(connection.peer_id, stream, layer)
        self._stats.unwanted += connection.outbox.want(stream, layer)
        if starts_again:
            self._resume(connection, room, stream, now)

    def catch_up(self, connection: Connection, room: Room, now: float) -> None:
        """Give a receiver who comes, or comes back, what was kept of every stream."""
        for number, _ in list(room.streams):  # asking closes a publisher that does not read
            if connection.closed is None:
                self._resume(connection, room, number, now)

    def _resume(self, connection: Connection, room: Room, number: int, now: float) -> None:
        """Give a receiver what was kept of a stream; ask for what it lacks to decode the rest."""
        stream = room.stream(number)
        if stream is None or not stream.chain:
            return  # nothing to miss: it begins with a keyframe
        outbox = connection.outbox
        is_whole = stream.is_whole and outbox.takes_chain(stream.num_bytes, now)
        chain = stream.chain if is_whole else stream.chain[:1]
        self._stats.frames_resumed += outbox.resume(number, chain, is_whole=is_whole, now=now)
        self._connections.ready[connection] = None
        if not is_whole:
            self.ask_for_keyframe(room, number, Put.KEYLESS.value, now)

    def ask_for_keyframe(self, room: Room, stream: int, why: str, now: float) -> None:
        """Ask a publisher for a keyframe, unless it was asked a moment ago."""
        connections = self._connections
        config = connections.config
        is_slow = why == Put.BEHIND.value
        interval_s = config.slow_keyframe_interval_s if is_slow else config.keyframe_interval_s
        publisher = room.request_keyframe(stream, interval_s, now)
        if publisher is None:
            self._stats.keyframe_requests["withheld"] += 1
            return
        self._stats.keyframe_requests[why] += 1
        connection = connections.by_peer.get(publisher)
        if connection is not None:
            connections.send(connection, KeyframeRequest(stream=stream), now)

    def mute(self, room: Room, number: int, stream: Stream, *, is_muted: bool, now: float) -> None:
        """Stop a stream, or let it go on, and tell everybody here."""
        stream.is_muted = is_muted
        room.forget_chain(number)
        for receiver in self._connections.connected(room):
            if is_muted:
                self._connections.note_dropped(receiver.outbox.interrupt(number), "muted")
            self._connections.send(receiver, StreamMuted(stream=number, is_muted=is_muted), now)
        if not is_muted and stream.deadline_s is None:
            stream.asked_s = None
            self.ask_for_keyframe(room, number, Put.KEYLESS.value, now)

    def forget_stream(self, room: Room, number: int) -> None:
        """Drop what waits of a stream that has ended."""
        for receiver in self._connections.connected(room):
            self._connections.note_dropped(receiver.outbox.forget_stream(number), "departed")

    def whisper(self, connection: Connection, whisper: Whisper, now: float) -> None:
        """Pass a whisper on, under its sender's name, or drop it."""
        room, stats = connection.room, self._stats
        assert room is not None
        if not connection.whispers.take(now):
            stats.whispers_dropped["rate"] += 1
            return
        connections = self._connections
        receiver = connections.by_peer.get(whisper.peer_id)
        if receiver is None or receiver is connection or receiver.room is not room:
            stats.whispers_dropped["nobody"] += 1
            return
        # Whispers of many must not fill the queue that closes a peer for reading too slowly.
        if receiver.outbox.waiting_control_bytes > connections.config.max_control_bytes // 4:
            stats.whispers_dropped["backlog"] += 1
            return
        connections.send(receiver, replace(whisper, peer_id=connection.peer_id), now)
        stats.whispers += 1
