"""Who is here, who publishes which stream, who wants how much of it, and what latecomers get.

Pure: a room knows peers by their id and frames by their bytes, nothing of connections. Of each
stream of faces it keeps the newest frame, so that who comes sees everybody at once.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, TypeVar

from pica_protocol.frame_queue import QueuedFrame
from pica_protocol.limits import MAX_STREAM
from pica_protocol.messages import SHARES, Join, Joined, Metadata, Peer, Track
from pica_server.tokens import Admission

_T = TypeVar("_T")

EVERY_MOST: Final = max(SHARES)
BAR: Final = ""
"""Stands for the whole participant in a decision, in place of a kind of track."""
MAX_DECISIONS: Final = 256
"""Decisions of admins that a room remembers; one more drops the oldest (chosen)."""


@dataclass(slots=True)
class _Member:
    peer: Peer
    every: dict[int, int] = field(default_factory=dict)
    """What is wanted by stream, see `Subscribe`; of one that is missing ``default_every``."""
    default_every: int = 1
    is_away: bool = False
    """Its connection is lost, and it may come back."""


@dataclass(slots=True)
class Stream:
    """One stream of a room."""

    number: int
    publisher: str
    """Who sends it: a peer id."""
    deadline_s: float | None = None
    """How long its frames may wait for a receiver if it is ordered; None: it is not."""
    is_muted: bool = False
    """An admin has stopped it."""
    newest: QueuedFrame | None = None
    """The newest frame, for those who come later; None of an ordered stream."""
    receivers: list[list[Any] | None] | None = None
    """Who gets its frames, by sequence modulo `EVERY_MOST`, as far as that is known: looked up for
    every frame, changed rarely."""


class Room:
    """One room and the subscriptions of its members.

    Attributes:
        streams: Every stream by its number; to be read only.
    """

    def __init__(self, name: str, capacity: int) -> None:
        self.name = name
        self._capacity = capacity
        self._members: dict[str, _Member] = {}
        self.streams: dict[int, Stream] = {}
        self._last_stream = 0
        self._decisions: dict[tuple[str, str], None] = {}

    def __len__(self) -> int:
        """How many are in the room, those who are away among them."""
        return len(self._members)

    def __contains__(self, peer_id: str) -> bool:
        return peer_id in self._members

    @property
    def is_full(self) -> bool:
        """Whether there is no place for one more here."""
        return len(self) >= self._capacity

    @property
    def peers(self) -> tuple[Peer, ...]:
        """Everybody in the room, in the order of their coming."""
        return tuple(member.peer for member in self._members.values())

    def join(self, peer_id: str, join: Join, admission: Admission) -> Joined:
        """Let a peer into a room that is not full, allot streams to its tracks, and return what to
        tell them."""
        peer = Peer(
            peer_id=peer_id,
            name=admission.name or join.name,
            tracks=tuple(replace(t, stream=self._new_stream(peer_id, t)) for t in join.tracks),
            metadata=join.metadata,
            identity=admission.identity,
            is_name_assured=bool(admission.name),
        )
        present = self.peers
        self._forget_receivers()
        self._members[peer_id] = _Member(peer, default_every=int(admission.may_subscribe))
        return self._joined(peer, present)

    def leave(self, peer_id: str) -> Peer:
        """Forget a peer, its streams and everybody's subscriptions for them."""
        self._forget_receivers()
        peer = self._members.pop(peer_id).peer
        for track in peer.tracks:
            del self.streams[track.stream]
            for member in self._members.values():
                member.every.pop(track.stream, None)
        return peer

    def go_away(self, peer_id: str) -> None:
        """Note that a peer has lost its connection: it wants nothing until it comes back."""
        self._forget_receivers()
        member = self._members[peer_id]
        member.is_away = True
        member.every.clear()
        member.default_every = 0

    def is_place_of(self, peer_id: str, identity: str, tracks: tuple[Track, ...]) -> bool:
        """Return True if a peer that comes back with these tracks had this place."""
        member = self._members.get(peer_id)
        if member is None or member.peer.identity != identity:
            return False
        return tuple(replace(track, stream=0) for track in member.peer.tracks) == tracks

    def is_like(self, peer_id: str, join: Join) -> bool:
        """Return True if a peer without an identity has the name and the tracks of one that joins:
        one that has crashed and restarted, as far as can be told."""
        name = self._members[peer_id].peer.name
        return name == join.name and self.is_place_of(peer_id, "", join.tracks)

    def muted_of(self, peer_id: str) -> tuple[int, ...]:
        """Return those streams of a peer that an admin has stopped."""
        tracks = self._members[peer_id].peer.tracks
        return tuple(t.stream for t in tracks if self.streams[t.stream].is_muted)

    def come_back(self, peer_id: str, *, may_subscribe: bool) -> Joined:
        """Give a peer its place again, without its subscriptions, and return what to tell it."""
        self._forget_receivers()
        member = self._members[peer_id]
        member.is_away = False
        member.every.clear()
        member.default_every = int(may_subscribe)
        others = tuple(peer for peer in self.peers if peer.peer_id != peer_id)
        return self._joined(member.peer, others, resumed=True)

    def _joined(self, peer: Peer, others: tuple[Peer, ...], *, resumed: bool = False) -> Joined:
        return Joined(
            room=self.name,
            peer_id=peer.peer_id,
            tracks=peer.tracks,
            peers=others,
            resumed=resumed,
            name=peer.name if peer.is_name_assured else "",
        )

    def update_metadata(self, peer_id: str, metadata: Metadata) -> bool:
        """Note what a peer says of itself; return whether it is something else than before."""
        member = self._members[peer_id]
        if member.peer.metadata == metadata:
            return False
        member.peer = replace(member.peer, metadata=metadata)
        return True

    @property
    def away(self) -> tuple[str, ...]:
        """Ids of those who have lost their connection and may come back."""
        return tuple(peer_id for peer_id, member in self._members.items() if member.is_away)

    def peer_of(self, identity: str) -> str | None:
        """Return the peer id of an identity in the room, or None."""
        found = (peer.peer_id for peer in self.peers if identity == peer.identity)
        return next(found, None) if identity else None

    def peer(self, peer_id: str) -> Peer:
        """Return one member as the others see it."""
        return self._members[peer_id].peer

    def subscribe(self, peer_id: str, stream: int, every: int) -> bool:
        """Note a subscription, if the stream has not just ended; return whether the peer wants
        frames of it after it wanted none."""
        member = self._members[peer_id]
        if stream not in self.streams or member.default_every == 0:
            return False
        self._forget_receivers()
        before, member.every[stream] = member.every.get(stream, 1), every
        return before == 0 and every > 0

    def decide(self, identity: str, kind: str, *, holds: bool) -> None:
        """Note an admin's decision on an identity: its tracks of a kind are muted, or with `BAR` it
        is barred. It holds until the room is empty, also when the participant joins again."""
        self._decisions.pop((identity, kind), None)
        if identity and holds:
            self._decisions[identity, kind] = None
            if len(self._decisions) > MAX_DECISIONS:
                del self._decisions[next(iter(self._decisions))]

    def is_decided(self, identity: str, kind: str = BAR) -> bool:
        """Return True if an identity is barred, or its tracks of a kind are muted."""
        return (identity, kind) in self._decisions

    def receivers(self, stream: Stream, sequence: int, by_peer: Mapping[str, _T]) -> list[_T]:
        """Return what a mapping holds for each peer that gets a frame of a stream; to be read only.
        It is kept until a peer comes, goes or subscribes."""
        place = sequence % EVERY_MOST
        if stream.receivers is None:
            stream.receivers = [None] * EVERY_MOST
        found = stream.receivers[place]
        if found is None:
            found = stream.receivers[place] = [
                by_peer[peer_id]
                for peer_id, member in self._members.items()
                if peer_id != stream.publisher
                and (every := member.every.get(stream.number, member.default_every))
                and place % every == 0
            ]
        return found

    def _forget_receivers(self) -> None:
        for stream in self.streams.values():
            stream.receivers = None

    def _new_stream(self, peer_id: str, track: Track) -> int:
        # Counting up, not lowest first: a late frame of a departed peer must not find a new owner.
        while True:
            self._last_stream = self._last_stream % MAX_STREAM + 1
            if self._last_stream not in self.streams:
                deadline_s = track.deadline_ms / 1000 if track.policy == "ordered" else None
                stream = Stream(self._last_stream, peer_id, deadline_s)
                self.streams[self._last_stream] = stream
                return self._last_stream
