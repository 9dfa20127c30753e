"""The client's end of a connection; see `pica_protocol.session` for how a shell uses it."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from pica_protocol import messages, session
from pica_protocol.errors import RemoteProtocolError
from pica_protocol.frame_queue import FrameQueue, QueuedFrame
from pica_protocol.frames import SEQUENCE_MODULUS, Frame, decode_media, encode_frame, media_message
from pica_protocol.limits import MAX_CONTROL_BYTES, MAX_MEDIA_MESSAGE_BYTES, MAX_PEERS

MAX_QUEUED_MESSAGES: Final = 256
"""Control messages a client may queue before its shell sends them (chosen: one whisper to each peer
of the largest room fits four times)."""

_NO_LIMIT: Final = 1 << 30

RIDE_S: Final = 0.045
"""After an ordered frame others wait so long at most for the next one, whose message they share
(chosen: packets of 40 ms, and the jitter of a timer): what surrounds a message is more than a
face."""


class ClientSession(session.Session[messages.Joined | messages.RoomNews | Frame]):
    """The client's end: joins one room, publishes frames, and keeps the list of peers.

    Attributes:
        peer_id: Our own id, once joined.
        name: What we are called; once joined, what the others are shown.
        tracks: Our own tracks; with their streams, once joined.
        peers: Everybody else in the room by id, kept up to date.
        is_admin: Whether we may moderate the room, once joined.
        muted: Streams that an admin has stopped, our own among them.
        drops: Frames that did not go out, by reason.
    """

    def __init__(
        self,
        *,
        room: str,
        name: str,
        tracks: tuple[messages.Track, ...] = (),
        now: float,
        timeout_s: float = session.HANDSHAKE_TIMEOUT_S,
        seal: Callable[[Frame], bytes] | None = None,
        token: str = "",
        metadata: messages.Metadata = (),
        resumable: bool = False,
        former: "ClientSession | None" = None,
        drops: Counter[str] | None = None,
    ) -> None:
        """Start on a websocket that is open: ``Join`` waits in ``messages_to_send``.

        Args:
            timeout_s: For the relay to let us in.
            seal: Makes the payload that travels out of a frame whose header is final.
            resumable: Whether another session may come back to the place of this one.
            former: A session whose connection broke, to come back to its place and go on with its
                sequence numbers; if the place is gone, we join again.
            drops: Of the sessions before, to be counted on.

        Raises:
            ValueError: A name, room, track, token or metadata is out of its limits.
        """
        super().__init__(session.CLIENT_TABLE, MAX_CONTROL_BYTES, now + timeout_s)
        self.peer_id = ""
        self.name = name
        self.tracks = tracks
        self.peers: dict[str, messages.Peer] = {}
        self.is_admin = False
        self.muted: frozenset[int] = frozenset()
        self.drops: Counter[str] = Counter() if drops is None else drops
        self._room = room
        self._seal = seal
        self._next_sequence = [0] * len(tracks)
        self._waiting = FrameQueue(self.drops)
        self._riding_until_s = -math.inf
        self._captured_s = 0.0
        # Of each peer the newest capture time, and when it came: times on the wire wrap.
        self._clocks: dict[str, tuple[int, float]] = {}
        self._publishers: dict[int, str] = {}
        self._former_sequences = None if former is None else former._next_sequence
        self._resume = ""
        self._queue(
            messages.Join(
                room=room,
                name=name,
                tracks=tracks,
                token=token,
                metadata=metadata,
                resumable=resumable,
                resume="" if former is None else former._resume,
            )
        )

    def messages_to_send(self, now: float) -> list[bytes]:
        """Take the websocket messages that must go out now, in order."""
        data = super().messages_to_send(now)
        due_s = self.frames_due_s
        if due_s is None or due_s > now:
            return data
        if self._waiting.has_ordered:
            self._riding_until_s = now + RIDE_S
        frames = self._waiting.take(_NO_LIMIT, self._captured_s)
        if self.state is session.State.JOINED:
            data += _media_messages([frame.data for frame in frames])
        return data

    @property
    def frames_due_s(self) -> float | None:
        """When the frames that wait go out; None: none waits."""
        if self._waiting.has_ordered:
            return -math.inf
        return self._riding_until_s if len(self._waiting) else None

    def send_frame(
        self, payload: bytes, captured_us: int, *, track: int = 0, multiple: int = 1
    ) -> bool:
        """Queue a frame of one of our tracks; of what waits too long less is sent, see
        `FrameQueue`.

        Args:
            multiple: The frame gets the next sequence number that is a multiple of this: of 4 when
                all shall have it who want but a quarter of the stream.

        Returns:
            False while not joined; the frame is gone then.

        Raises:
            ValueError: The payload is too long, or another field out of its limits.
        """
        if self.state is not session.State.JOINED:
            return False
        stream, deadline_s = self.tracks[track].stream, self.tracks[track].deadline_s
        # One that replaces another takes its number: a hole would look like a loss on the way.
        next_sequence = self._next_sequence[track] - self._waiting.will_replace(stream)
        sequence = (next_sequence + -next_sequence % multiple) % SEQUENCE_MODULUS
        frame = Frame(stream=stream, sequence=sequence, captured_us=captured_us, payload=payload)
        self._next_sequence[track] = (sequence + 1) % SEQUENCE_MODULUS
        if stream in self.muted:
            self.drops["muted"] += 1
            return True
        if self._seal is not None:
            frame = replace(frame, payload=self._seal(frame))
        # The capture time is all the clock we have here; only differences count.
        self._captured_s = captured_us / 1e6
        data = encode_frame(frame)
        self._waiting.put(QueuedFrame("", stream, data, self._captured_s, deadline_s))
        return True

    def tell(self, message: messages.FromMember) -> bool:
        """Say something to the relay, or through it: a whisper may be dropped without notice.

        Returns:
            False if it could not be said: not joined, or too much waits to be sent.
        """
        is_joined = self.state is session.State.JOINED
        if not is_joined or len(self._outgoing) >= MAX_QUEUED_MESSAGES:
            return False
        self._queue(message)
        return True

    @property
    def is_resumable(self) -> bool:
        """Whether another session can come back to the place of this one, once."""
        return bool(self._resume)

    def _receive_frames(self, data: bytes, now: float) -> list[session.ClientEvent]:
        frames = decode_media(data, lambda stream: self._expected_us(stream, now))
        self._advance(session.Media)
        for frame in frames:
            if peer_id := self._publishers.get(frame.stream):
                self._clocks[peer_id] = frame.captured_us, now
        return list[session.ClientEvent](frames)

    def _receive_message(self, message: messages.Message) -> list[session.ClientEvent]:
        match message:
            case messages.Joined():
                if [replace(track, stream=0) for track in message.tracks] != list(self.tracks):
                    raise RemoteProtocolError("joined with other tracks than ours")
                if message.room != self._room:
                    raise RemoteProtocolError(f"joined room {message.room}, not the one asked for")
                self.peer_id = message.peer_id
                self.name = message.name or self.name
                self.is_admin = message.is_admin
                self.tracks = message.tracks
                self._set_peers(message.peers)
                self._deadline = None
                self._resume = message.resume
                if message.resumed:
                    if self._former_sequences is None:
                        raise RemoteProtocolError("resumed, and we did not ask to")
                    self._next_sequence = list(self._former_sequences)
            case messages.PeerJoined(peer=peer):
                # One id is one peer: the one that had it has gone.
                is_known = peer.peer_id in self.peers
                self._clocks.pop(peer.peer_id, None)
                self._set_peers(list({**self.peers, peer.peer_id: peer}.values()))
                if is_known:
                    return [messages.PeerLeft(peer_id=peer.peer_id), message]
            case messages.PeerLeft(peer_id=peer_id):
                self._set_peers([each for each in self.peers.values() if each.peer_id != peer_id])
            case messages.PeerUpdated(peer_id=peer_id, metadata=metadata):
                if peer_id in self.peers:
                    self.peers[peer_id] = replace(self.peers[peer_id], metadata=metadata)
            case messages.StreamMuted(stream=stream, is_muted=is_muted):
                # Replaced and never changed: other threads read it.
                self.muted = self.muted | {stream} if is_muted else self.muted - {stream}
        assert isinstance(message, messages.Joined | messages.RoomNews)  # so says the table
        return [message]

    def _set_peers(self, peers: Sequence[messages.Peer]) -> None:
        """Take everybody else in the room.

        A room is refused that has too many peers, which would fill our memory, or an id or a stream
        twice, ours among them: faces are told apart by their streams.
        """
        if len(peers) > MAX_PEERS:
            raise RemoteProtocolError(f"more than {MAX_PEERS} peers in a room")
        found = {peer.peer_id: peer for peer in peers}
        if len(found) < len(peers) or self.peer_id in found:
            raise RemoteProtocolError("a room that has a peer twice")
        owners = [(track.stream, peer.peer_id) for peer in peers for track in peer.tracks]
        streams = {stream for stream, _ in owners} | {track.stream for track in self.tracks}
        if len(streams) < len(owners) + len(self.tracks):
            raise RemoteProtocolError("a room that has a stream twice")
        self.peers, self._publishers = found, dict(owners)
        self._clocks = {each: clock for each, clock in self._clocks.items() if each in found}

    def _expected_us(self, stream: int, now: float) -> int:
        """Return about what time a peer's clock shows: as long after its newest frame as ours. All
        tracks of a peer share a clock; before its first frame, ours is assumed."""
        captured_us, received_s = self._clocks.get(self._publishers.get(stream, ""), (0, 0.0))
        return captured_us + round((now - received_s) * 1e6)


def _media_messages(frames: list[bytes]) -> list[bytes]:
    """Put frames into as few messages as hold them, in order."""
    found: list[bytes] = []
    batch: list[bytes] = []
    room_left = 0
    for frame in frames:
        room_left -= len(frame)
        if room_left < 0 and batch:
            found.append(media_message(batch))
            batch = []
        if not batch:
            room_left = MAX_MEDIA_MESSAGE_BYTES - 1 - len(frame)
        batch.append(frame)
    return [*found, media_message(batch)] if batch else found
