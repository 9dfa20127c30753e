"""Who is here, who publishes which stream, who wants how much of it, and what latecomers get. Pure.

Of each stream of faces a room keeps the newest frame, so that who comes sees everybody at once. A
member whose connection is over is away, and may come back on another one.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, Final

from pica_protocol.frame_queue import QueuedFrame
from pica_protocol.limits import MAX_STREAM
from pica_protocol.messages import SHARES, Join, Joined, Peer, Track
from pica_protocol.session import Closed, ServerSession
from pica_server.limits import TokenBucket
from pica_server.room.outbox import Outbox
from pica_server.tokens import Admission

EVERY_MOST: Final = max(SHARES)
BAR: Final = ""
"""Stands for the whole participant in a decision, in place of a kind of track."""
MAX_DECISIONS: Final = 256
"""Decisions of admins that a room remembers; one more drops the oldest (chosen)."""


@dataclass(eq=False, slots=True)
class Connection:
    """One websocket as the hub sees it; the shell reads ``closed``. In a room it is a member."""

    serial: int
    session: ServerSession
    outbox: Outbox
    address: str
    bytes_in: TokenBucket
    told: TokenBucket
    """What it has the relay tell others, see `connections.TOLD_PER_S`."""
    peer_id: str
    room: "Room | None" = None
    peer: Peer = field(init=False)
    """As the others see it; from its join on."""
    every: dict[int, int] = field(default_factory=dict)
    """What it wants by stream, see `Subscribe`; of one that is missing ``default_every``."""
    default_every: int = 1
    late_s: float = math.inf
    """When it has not read for too long what it was sent."""
    away_until_s: float = math.inf
    """When its place is given up, after the connection was lost."""
    ticket: bytes = b""
    """Hash of the secret to come back with; empty: its place is not kept."""
    is_crowded: bool = False
    """One more than its address may have."""
    is_resumable: bool = False
    has_joined: bool = False
    is_admin: bool = False
    """Whether its token has the grant ``admin``."""
    shell: Any = None
    """What the shell keeps of it."""

    @property
    def closed(self) -> Closed | None:
        """How it ended, or None."""
        return self.session.closed


@dataclass(slots=True)
class Stream:
    """One stream of a room."""

    number: int
    publisher: str
    """The id of the peer that sends it."""
    deadline_s: float | None = None
    """How long its frames may wait for a receiver if it is ordered; None: it is not."""
    is_muted: bool = False
    """An admin has stopped it."""
    newest: QueuedFrame | None = None
    """The newest frame, for those who come later; None of an ordered stream."""
    receivers: list[list[Connection] | None] | None = None
    """The receivers of its frames, by sequence modulo `EVERY_MOST`, as far as that is known: looked
    up for every frame, changed rarely."""


class Room:
    """One room and the subscriptions of its members.

    Attributes:
        members: All by their peer id, in the order of their coming, also those who are away; to be
            read only.
        streams: Every stream by its number; to be read only.
    """

    def __init__(self, name: str, capacity: int) -> None:
        self.name = name
        self._capacity = capacity
        self.members: dict[str, Connection] = {}
        self.streams: dict[int, Stream] = {}
        self._last_stream = 0
        self._decisions: dict[tuple[str, str], None] = {}

    @property
    def is_full(self) -> bool:
        """Whether there is no place for one more here."""
        return len(self.members) >= self._capacity

    @property
    def connected(self) -> list[Connection]:
        """The members that are not away."""
        return [member for member in self.members.values() if member.closed is None]

    @property
    def away(self) -> list[Connection]:
        """Those who have lost their connection and may come back."""
        return [member for member in self.members.values() if member.closed is not None]

    def join(self, member: Connection, join: Join, admission: Admission) -> Joined:
        """Let a peer into a room that is not full, allot streams to its tracks, and return what to
        tell it."""
        peer_id = member.peer_id
        member.peer = Peer(
            peer_id=peer_id,
            name=admission.name or join.name,
            tracks=tuple(replace(t, stream=self._new_stream(peer_id, t)) for t in join.tracks),
            metadata=join.metadata,
            identity=admission.identity,
            is_name_assured=bool(admission.name),
        )
        return self._take(member, admission, resumed=False)

    def come_back(self, member: Connection, former: Connection, admission: Admission) -> Joined:
        """Give a connection the place of a member, without the subscriptions, and return what to
        tell it."""
        member.peer_id, member.peer = former.peer_id, former.peer
        return self._take(member, admission, resumed=True)

    def _take(self, member: Connection, admission: Admission, *, resumed: bool) -> Joined:
        self.forget_receivers()
        self.members[member.peer_id] = member
        member.room, member.is_admin = self, admission.may_admin
        member.default_every = int(admission.may_subscribe)
        peer = member.peer
        return Joined(
            room=self.name,
            peer_id=peer.peer_id,
            tracks=peer.tracks,
            peers=tuple(each.peer for each in self.members.values() if each is not member),
            resumed=resumed,
            name=peer.name if peer.is_name_assured else "",
            is_admin=member.is_admin,
        )

    def leave(self, member: Connection) -> None:
        """Forget a peer, its streams and everybody's subscriptions for them."""
        self.forget_receivers()
        del self.members[member.peer_id]
        for track in member.peer.tracks:
            del self.streams[track.stream]
            for other in self.members.values():
                other.every.pop(track.stream, None)

    def muted_of(self, members: Iterable[Connection]) -> list[int]:
        """Return those streams of some members that an admin has stopped."""
        streams = (track.stream for member in members for track in member.peer.tracks)
        return [stream for stream in streams if self.streams[stream].is_muted]

    def find(self, identity: str) -> Connection | None:
        """Return the member with an identity, or None."""
        found = (each for each in self.members.values() if each.peer.identity == identity)
        return next(found, None) if identity else None

    def subscribe(self, member: Connection, stream: int, every: int) -> bool:
        """Note a subscription, if the stream has not just ended; return whether the peer wants
        frames of it after it wanted none."""
        if stream not in self.streams or member.default_every == 0:
            return False
        self.forget_receivers()
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

    def receivers(self, stream: Stream, sequence: int) -> list[Connection]:
        """Return the members that get a frame of a stream; to be read only. It is kept until
        `forget_receivers`."""
        place = sequence % EVERY_MOST
        if stream.receivers is None:
            stream.receivers = [None] * EVERY_MOST
        found = stream.receivers[place]
        if found is None:
            found = stream.receivers[place] = [
                member
                for member in self.connected
                if member.peer_id != stream.publisher
                and (every := member.every.get(stream.number, member.default_every))
                and place % every == 0
            ]
        return found

    def forget_receivers(self) -> None:
        """Note that a member comes, goes or subscribes."""
        for stream in self.streams.values():
            stream.receivers = None

    def _new_stream(self, peer_id: str, track: Track) -> int:
        # Counting up, not lowest first: a late frame of a departed peer must not find a new owner.
        while True:
            self._last_stream = self._last_stream % MAX_STREAM + 1
            if self._last_stream not in self.streams:
                stream = Stream(self._last_stream, peer_id, track.deadline_s)
                self.streams[self._last_stream] = stream
                return self._last_stream
