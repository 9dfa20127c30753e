"""Who is here, who publishes which stream, and who wants how much of it.

Pure: a room knows peers by their id and frames by their bytes, nothing of connections.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from pica_protocol.limits import MAX_LAYER, MAX_STREAM
from pica_protocol.messages import Joined, Peer, Track
from pica_server.errors import RoomFullError

_NOTHING = -1
"""As the highest wanted layer: none."""


@dataclass(slots=True)
class _Member:
    peer: Peer
    highest_layer: dict[int, int] = field(default_factory=dict)
    """By stream; a stream that is missing is wanted whole."""


class Room:
    """One room and the wishes of its members.

    Attributes:
        name: As the peers know it.
    """

    def __init__(self, name: str, capacity: int, keyframe_interval_s: float) -> None:
        self.name = name
        self._capacity = capacity
        self._keyframe_interval_s = keyframe_interval_s
        self._members: dict[str, _Member] = {}
        self._publishers: dict[int, str] = {}
        self._keyframes: dict[int, bytes] = {}
        self._keyframe_asked_s: dict[int, float] = {}
        self._last_stream = 0

    def __len__(self) -> int:
        return len(self._members)

    @property
    def peers(self) -> tuple[Peer, ...]:
        """Everybody here, in the order of their coming."""
        return tuple(member.peer for member in self._members.values())

    @property
    def keyframes(self) -> Mapping[int, bytes]:
        """The last keyframe of every stream that has sent one."""
        return self._keyframes

    def join(self, peer_id: str, name: str, tracks: tuple[Track, ...]) -> Joined:
        """Let a peer in, allot streams to its tracks, and return what to tell it.

        Raises:
            RoomFullError: The room has no place left.
        """
        if len(self._members) >= self._capacity:
            raise RoomFullError(f"room {self.name} is full: {self._capacity} peers")
        present = self.peers
        own = tuple(replace(track, stream=self._new_stream(peer_id)) for track in tracks)
        self._members[peer_id] = _Member(Peer(peer_id=peer_id, name=name, tracks=own))
        return Joined(room=self.name, peer_id=peer_id, tracks=own, peers=present)

    def leave(self, peer_id: str) -> Peer:
        """Forget a peer, its streams and everybody's wishes for them."""
        peer = self._members.pop(peer_id).peer
        for track in peer.tracks:
            del self._publishers[track.stream]
            self._keyframes.pop(track.stream, None)
            self._keyframe_asked_s.pop(track.stream, None)
            for member in self._members.values():
                member.highest_layer.pop(track.stream, None)
        return peer

    def peer(self, peer_id: str) -> Peer:
        """Return one member as the others see it."""
        return self._members[peer_id].peer

    def want(self, peer_id: str, stream: int, layer: int | None) -> None:
        """Note a wish; one for a stream that has just ended is no mistake and changes nothing."""
        if stream in self._publishers:
            wishes = self._members[peer_id].highest_layer
            wishes[stream] = _NOTHING if layer is None else layer

    def owns(self, peer_id: str, stream: int) -> bool:
        """Say whether this peer publishes this stream."""
        return self._publishers.get(stream) == peer_id

    def receivers(self, stream: int, layer: int) -> list[str]:
        """Return who gets a frame of this stream and layer."""
        publisher = self._publishers[stream]
        return [
            peer_id
            for peer_id, member in self._members.items()
            if member.highest_layer.get(stream, MAX_LAYER) >= layer and peer_id != publisher
        ]

    def remember_keyframe(self, stream: int, frame: bytes) -> None:
        """Keep the last keyframe of a stream for those who come later."""
        self._keyframes[stream] = frame

    def request_keyframe(self, stream: int, now: float) -> str | None:
        """Return the publisher to ask, or None if it was asked a moment ago or is gone."""
        publisher = self._publishers.get(stream)
        if publisher is None:
            return None
        asked_s = self._keyframe_asked_s.get(stream)
        if asked_s is not None and now - asked_s < self._keyframe_interval_s:
            return None
        self._keyframe_asked_s[stream] = now
        return publisher

    def _new_stream(self, peer_id: str) -> int:
        # Counting up, not lowest first: a late frame of a departed peer must not find a new owner.
        while True:
            self._last_stream = self._last_stream % MAX_STREAM + 1
            if self._last_stream not in self._publishers:
                self._publishers[self._last_stream] = peer_id
                return self._last_stream
