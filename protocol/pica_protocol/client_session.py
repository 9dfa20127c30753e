"""The client's end of a connection; see `pica_protocol.session` for how a shell uses it."""

import math
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from typing import Final

from pica_protocol import messages, session
from pica_protocol.codec import decode_message
from pica_protocol.errors import CloseCode, LocalProtocolError, RemoteProtocolError
from pica_protocol.frame_queue import FrameQueue, QueuedFrame
from pica_protocol.frames import (
    MEDIA_KIND,
    SEQUENCE_MODULUS,
    Frame,
    decode_media,
    encode_frame,
    media_message,
)
from pica_protocol.limits import MAX_CONTROL_BYTES, MAX_MEDIA_MESSAGE_BYTES, MAX_PEERS

MAX_QUEUED_MESSAGES: Final = 256
"""Control messages a client may queue before its shell sends them (chosen: one whisper to each peer
of the largest room fits four times)."""

_NO_LIMIT: Final = 1 << 30

RIDE_S: Final = 0.045
"""After an ordered frame others wait so long at most for the next one, whose message they share
(chosen: packets of 40 ms, and the jitter of a timer): what surrounds a message is more than a
face."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Ticket:
    """What a client comes back with after its connection broke, to the place that it had."""

    secret: str = field(repr=False)
    next_sequences: tuple[int, ...]
    """Of each track: streams go on where they stopped, so the others see what was lost as a
    hole."""


class ClientSession(session.Session):
    """The client's end: joins one room, publishes frames, and keeps the list of peers.

    Attributes:
        peer_id: Our own id, once joined.
        name: What we are called; once joined, what the others are shown.
        tracks: Our own tracks; with their streams, once joined.
        peers: Everybody else in the room by id, kept up to date.
        is_admin: Whether we may moderate the room, once joined.
        muted: Streams that an admin has stopped, our own among them.
        drops: Frames that did not go out because the network was too slow, by reason.
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
        ticket: Ticket | None = None,
        drops: Counter[str] | None = None,
    ) -> None:
        """Start on a websocket that is open: ``Join`` waits in ``messages_to_send``.

        Args:
            timeout_s: For the relay to let us in.
            seal: Makes the payload that travels out of a frame whose header is final.
            resumable: Whether we may come back with the `ticket` of this session.
            ticket: Of the last session, to come back to its place; if that is gone, we join again.
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
        self.drops = Counter() if drops is None else drops
        self._room = room
        self._seal = seal
        self._next_sequence = [0] * len(tracks)
        self._waiting = FrameQueue(self.drops)
        self._riding_until_s = -math.inf
        self._captured_s = 0.0
        # Of each peer the newest capture time, and when it came: times on the wire wrap.
        self._clocks: dict[str, tuple[int, float]] = {}
        self._publishers: dict[int, str] = {}
        self._came_with = ticket
        self._resume = ""
        self._queue(
            messages.Join(
                room=room,
                name=name,
                tracks=tracks,
                token=token,
                metadata=metadata,
                resumable=resumable,
                resume="" if ticket is None else ticket.secret,
            )
        )

    def receive_data(self, data: bytes | str, now: float) -> list[session.ClientEvent]:
        """Take one websocket message; a text one is the other side's mistake."""
        if self.state is session.State.CLOSED:
            return []
        try:
            data = session.binary(data)
            if data[0] == MEDIA_KIND:
                frames = decode_media(data, lambda stream: self._expected_us(stream, now))
                self._advance(session.Media)
                if self.state is session.State.LEAVING:
                    return []
                for frame in frames:
                    if peer_id := self._publishers.get(frame.stream):
                        self._clocks[peer_id] = frame.captured_us, now
                return list[session.ClientEvent](frames)
            return self._receive_message(decode_message(data, self._max_bytes))
        except RemoteProtocolError as error:
            return [self._end(error.code, str(error), is_remote=False)]

    def messages_to_send(self, now: float) -> list[bytes]:
        """Take the websocket messages that must go out now, in order."""
        data, self._outgoing = self._outgoing, []
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

    def handle_timer(self, now: float) -> list[session.ClientEvent]:
        """Give up if the relay has not let us in, or out, by now."""
        if self._deadline is None or now < self._deadline:
            return []
        if self.state is session.State.LEAVING:
            return [self._end(CloseCode.NORMAL, "left", is_remote=False)]
        reason = f"the relay did not answer in time while {self.state.value}"
        return [self._end(CloseCode.HANDSHAKE_TIMEOUT, reason, is_remote=False)]

    def send_frame(
        self, payload: bytes, captured_us: int, *, track: int = 0, multiple: int = 1
    ) -> None:
        """Queue a frame of one of our tracks; of what waits too long less is sent, see
        `FrameQueue`.

        Args:
            multiple: The frame gets the next sequence number that is a multiple of this: of 4 when
                all shall have it who want but a quarter of the stream.

        Raises:
            LocalProtocolError: Not joined, or there is no such track.
            ValueError: The payload is too long, or another field out of its limits.
        """
        if self.state is not session.State.JOINED or not 0 <= track < len(self.tracks):
            raise LocalProtocolError(f"cannot send on track {track} while {self.state.value}")
        stream, policy = self.tracks[track].stream, self.tracks[track].policy
        # One that replaces another takes its number: a hole would look like a loss on the way.
        next_sequence = self._next_sequence[track] - self._waiting.will_replace(stream)
        sequence = (next_sequence + -next_sequence % multiple) % SEQUENCE_MODULUS
        frame = Frame(stream=stream, sequence=sequence, captured_us=captured_us, payload=payload)
        self._next_sequence[track] = (sequence + 1) % SEQUENCE_MODULUS
        if stream in self.muted:
            self.drops["muted"] += 1
            return
        if self._seal is not None:
            frame = replace(frame, payload=self._seal(frame))
        deadline_s = self.tracks[track].deadline_ms / 1000 if policy == "ordered" else None
        # The capture time is all the clock we have here; only differences count.
        self._captured_s = captured_us / 1e6
        data = encode_frame(frame)
        self._waiting.put(QueuedFrame("", stream, data, self._captured_s, deadline_s))

    def tell(self, message: messages.FromMember) -> None:
        """Say something to the relay, or through it: a whisper may be dropped without notice.

        Raises:
            LocalProtocolError: Not joined, or too much waits.
        """
        if self.state is not session.State.JOINED:
            raise LocalProtocolError(
                f"cannot send {type(message).__name__} while {self.state.value}"
            )
        if len(self._outgoing) >= MAX_QUEUED_MESSAGES:
            raise LocalProtocolError(
                f"{MAX_QUEUED_MESSAGES} messages wait to be sent: drain messages_to_send"
            )
        self._queue(message)

    @property
    def ticket(self) -> Ticket | None:
        """What to come back with if this connection breaks, or None: it may be used once."""
        if not self._resume:
            return None
        return Ticket(secret=self._resume, next_sequences=tuple(self._next_sequence))

    @property
    def can_queue(self) -> bool:
        """Whether a control message can be queued now: joined, and not too many of them wait."""
        return self.state is session.State.JOINED and len(self._outgoing) < MAX_QUEUED_MESSAGES

    def leave(self, now: float, timeout_s: float = 1.0) -> None:
        """Go in good order: the relay answers with ``Bye``, or we stop waiting for it."""
        if self.state in (session.State.CLOSED, session.State.LEAVING):
            return
        self.state = session.State.LEAVING
        self._queue(messages.Leave())
        self._deadline = now + timeout_s

    def _receive_message(self, message: messages.Message) -> list[session.ClientEvent]:
        if isinstance(message, messages.Bye):
            return [self._end(message.code, message.reason, is_remote=True, url=message.url)]
        self._advance(type(message))
        if self.state is session.State.LEAVING:
            return []
        match message:
            case messages.Joined():
                if [replace(track, stream=0) for track in message.tracks] != list(self.tracks):
                    raise RemoteProtocolError("joined with other tracks than ours")
                if message.room != self._room:
                    raise RemoteProtocolError(f"joined room {message.room}, not the one asked for")
                self._check_peers(message.peer_id, message.tracks, message.peers)
                self.peer_id = message.peer_id
                self.name = message.name or self.name
                self.is_admin = message.is_admin
                self.tracks = message.tracks
                self.peers = {peer.peer_id: peer for peer in message.peers}
                self._note_streams(*message.peers)
                self._deadline = None
                self._resume = message.resume
                if message.resumed:
                    if self._came_with is None:
                        raise RemoteProtocolError("resumed, and we did not ask to")
                    self._next_sequence = list(self._came_with.next_sequences)
            case messages.PeerJoined(peer=peer):
                # A relay that does not keep to it would fill our memory.
                if len(self.peers) >= MAX_PEERS and peer.peer_id not in self.peers:
                    raise RemoteProtocolError(f"more than {MAX_PEERS} peers in a room")
                others = {**self.peers, peer.peer_id: peer}
                self._check_peers(self.peer_id, self.tracks, others.values())
                # One id is one peer: the one that had it has gone.
                is_known, self.peers = peer.peer_id in self.peers, others
                self._forget_streams(peer.peer_id)
                self._note_streams(peer)
                if is_known:
                    return [messages.PeerLeft(peer_id=peer.peer_id), message]
            case messages.PeerLeft(peer_id=peer_id):
                self.peers.pop(peer_id, None)
                self._forget_streams(peer_id)
            case messages.PeerUpdated(peer_id=peer_id, metadata=metadata):
                if peer_id in self.peers:
                    self.peers[peer_id] = replace(self.peers[peer_id], metadata=metadata)
            case messages.StreamMuted(stream=stream, is_muted=is_muted):
                # Replaced and never changed: other threads read it.
                self.muted = self.muted | {stream} if is_muted else self.muted - {stream}
        assert isinstance(message, messages.Joined | messages.RoomNews)  # so says the table
        return [message]

    def _note_streams(self, *peers: messages.Peer) -> None:
        for peer in peers:
            self._publishers |= {track.stream: peer.peer_id for track in peer.tracks}

    def _forget_streams(self, peer_id: str) -> None:
        self._clocks.pop(peer_id, None)
        self._publishers = {s: each for s, each in self._publishers.items() if each != peer_id}

    def _expected_us(self, stream: int, now: float) -> int:
        """Return about what time a peer's clock shows: as long after its newest frame as ours. All
        tracks of a peer are on one clock; of who has sent nothing yet it is taken to be ours."""
        captured_us, received_s = self._clocks.get(self._publishers.get(stream, ""), (0, 0.0))
        return captured_us + round((now - received_s) * 1e6)

    @staticmethod
    def _check_peers(
        own_id: str, own: tuple[messages.Track, ...], peers: Collection[messages.Peer]
    ) -> None:
        """Refuse a room in which we are our own peer, or an id or a stream is there twice: faces
        are told apart by their streams."""
        ids = [own_id, *(peer.peer_id for peer in peers)]
        streams = [track.stream for peer in peers for track in peer.tracks]
        streams += [track.stream for track in own]
        for what, values in (("peer", ids), ("stream", streams)):
            if len(set(values)) < len(values):
                raise RemoteProtocolError(f"a room that has a {what} twice")


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
