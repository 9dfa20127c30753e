"""Who is in which room of one relay: coming, going, being away for a while, coming back. Pure.

A peer has a connection, or it is away: its connection broke, and its place is kept for a while. A
connection that comes back with the secret of the place takes the id of the peer there. A secret is
good once, and only its hash is kept: nothing that is looked at or printed here lets anybody in.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

from pica_protocol.errors import CloseCode
from pica_protocol.messages import (
    BarIdentity,
    Join,
    Joined,
    Metadata,
    Moderation,
    MutePeer,
    PeerAway,
    PeerJoined,
    PeerLeft,
    PeerUpdated,
    RemovePeer,
    StreamMuted,
    UpdateMetadata,
)
from pica_protocol.session import Closed
from pica_server.limits import MOST_REMEMBERED, RefusalError, TokenBucket
from pica_server.room.connections import CALM_S, MODERATION_COST, UPDATE_COST, Connections, Overload
from pica_server.room.room import BAR, Connection, Room
from pica_server.tokens import Admission

OWN_JOINS_PER_S: Final = 1.0
OWN_JOINS_BURST: Final = 10.0
"""How often one identity may join, or else one address (chosen: a household behind one address
comes together, and a page that is loaded again and again is no attack)."""


class _Placement(Protocol):
    """Finds the relay of a room that is not here, and tells `Membership.follow`; see
    `pica_server.placement`."""

    is_up: bool

    def ask(self, room: str) -> None: ...
    def note_started(self, room: str) -> None: ...
    def note_ended(self, room: str) -> None: ...
    def refuge(self) -> str: ...


@dataclass(eq=False)
class Membership:
    """The rooms of one relay and who is in them; it clears up after the connections.

    Attributes:
        rooms: Every room with a peer in it, by name; to be read only.
        placement: Finds the relay of a room that is not here; None without other relays.
    """

    _connections: Connections
    _admit: Callable[[Join], Admission]
    """Says what who joins may do, or raises `RefusalError`."""
    _overload: Overload
    _new_secret: Callable[[], str] | None
    """Makes secrets to come back with; None: no place is kept."""

    def __post_init__(self) -> None:
        self._stats = self._connections.stats
        self.rooms: dict[str, Room] = {}
        self._away: dict[Connection, None] = {}  # in the order of their going
        self._places: dict[bytes, Connection] = {}  # members by the hash of the secret
        self._joins: TokenBucket | None = None  # full when the first one comes
        # By identity, or else by address; drops the oldest.
        self._own_joins: dict[str, TokenBucket] = {}
        self.placement: _Placement | None = None
        # Joins that wait until the relay of their room is known, at most one for each connection.
        self._waiting: dict[str, list[tuple[Connection, Join, Admission]]] = {}
        self._connections.on_over = self.clear_up

    def join(self, connection: Connection, join: Join, now: float) -> None:
        """Let a peer into a room, or raise `RefusalError`."""
        if connection.is_crowded and self._place_of(join) is None:
            most = self._connections.config.limits.connections_per_address
            raise RefusalError(
                f"{most} connections from one address", CloseCode.TOO_MANY, "address"
            )
        # First of all: clients without a token must not use up the joins of those with one.
        admission = self._admit(join)
        place = self._place_of(join, admission.identity)
        payer = admission.identity or (connection.address if place is None else place.peer_id)
        if not self._may_join(payer, now, is_back=place is not None):
            raise RefusalError("too many join at once, try again", CloseCode.BUSY, "joins")
        if self.placement is None or join.room in self.rooms:
            self._let_in(connection, join, admission, now)
        else:
            self._waiting.setdefault(join.room, []).append((connection, join, admission))
            self.placement.ask(join.room)

    def _may_join(self, payer: str, now: float, *, is_back: bool) -> bool:
        """Return True if there is room for one more join, of this identity, place or address, and
        in all; coming back to a place costs no other peer a join."""
        limits = self._connections.config.limits
        if self._joins is None:
            self._joins = TokenBucket(limits.joins_per_s, limits.joins_burst, now)
        own = self._own_joins.pop(payer, None)
        if own is None:
            own = TokenBucket(OWN_JOINS_PER_S, OWN_JOINS_BURST, now)
        if payer:
            self._own_joins[payer] = own
            if len(self._own_joins) > MOST_REMEMBERED:
                del self._own_joins[next(iter(self._own_joins))]
        return own.take(now) and (is_back or self._joins.take(now))

    def follow(self, room: str, url: str | None, now: float) -> None:
        """Admit joins for a room that is placed here, or redirect them, and its peers, to the relay
        at an address ("" if there is none)."""
        waiting = [w for w in self._waiting.pop(room, []) if w[0].closed is None]
        if url is not None:
            self.send_elsewhere(room, [connection for connection, _, _ in waiting], url, now)
            return
        for connection, join, admission in waiting:
            try:
                self._let_in(connection, join, admission, now)
            except RefusalError as error:
                self._connections.refuse(connection, error, now)

    def send_elsewhere(
        self, room_name: str, waiting: Sequence[Connection], url: str, now: float
    ) -> None:
        """Redirect the peers of a room, and joins that wait for it."""
        room = self.rooms.get(room_name)
        inside = [] if room is None else room.connected
        self._connections.send_elsewhere([*waiting, *inside], now, url)
        for member in [] if room is None else room.away:
            self._give_up(member, "lost", now)

    def _let_in(self, connection: Connection, join: Join, admission: Admission, now: float) -> None:
        """Let a peer into a room of this relay, or raise `RefusalError`."""
        capacity = self._connections.config.room_capacity
        connection.is_resumable = join.resumable
        if join.resume and self._come_back(connection, join, admission, now):
            return
        room = self.rooms.get(join.room) or Room(join.room, capacity)
        if self._overload.refuses(now) and room.find(admission.identity) is None:
            reason = f"the relay has too much to do, try again in {CALM_S:g} s"
            raise RefusalError(reason, CloseCode.BUSY, "late")
        self._replace(room, connection, join, admission.identity, now)
        if room.is_decided(admission.identity):
            raise RefusalError(
                "an admin has barred you until the room is empty", CloseCode.FORBIDDEN
            )
        if room.is_full:
            reason = f"room {join.room} is full: {capacity} peers"
            raise RefusalError(reason, CloseCode.ROOM_FULL, "room")
        if not room.members:  # new, or its last member has just been replaced
            room = Room(join.room, capacity)
        self._enter(connection, room, room.join(connection, join, admission), now)

    def update_metadata(self, member: Connection, update: UpdateMetadata, now: float) -> None:
        """Note what a peer says of itself, and tell the others."""
        if not member.told.take(now, UPDATE_COST):
            raise RefusalError("metadata changes too often", CloseCode.TOO_FAST, "metadata")
        self._note_metadata(member, update.metadata, now)

    def _note_metadata(self, member: Connection, metadata: Metadata, now: float) -> None:
        assert member.room is not None
        if member.peer.metadata != metadata:
            member.peer = replace(member.peer, metadata=metadata)
            news = PeerUpdated(peer_id=member.peer_id, metadata=metadata)
            self._connections.tell_others(member.room, member, news, now)

    def moderate(self, member: Connection, asked: Moderation, now: float) -> None:
        """Do what an admin asks for, or raise `RefusalError`. A participant who is not in the room
        any more is left alone: the request and the leaving have crossed."""
        room = member.room
        assert room is not None  # the session's table: only while joined
        if not member.is_admin:
            raise RefusalError("your token does not let you moderate", CloseCode.FORBIDDEN)
        if not member.told.take(now, MODERATION_COST):
            raise RefusalError("you moderate too often", CloseCode.TOO_FAST, "moderation")
        removed: Connection | None = None
        match asked:
            case RemovePeer(peer_id=peer_id):
                removed = room.members.get(peer_id)
            case MutePeer(peer_id=peer_id, kind=kind, is_muted=is_muted) if peer_id in room.members:
                peer = room.members[peer_id].peer
                for stream in (room.streams[t.stream] for t in peer.tracks if t.kind == kind):
                    if stream.is_muted is not is_muted:
                        room.decide(peer.identity, kind, holds=is_muted)
                        self._connections.mute(room, stream, is_muted=is_muted, now=now)
            case BarIdentity(identity=identity, is_barred=is_barred):
                room.decide(identity, BAR, holds=is_barred)
                removed = room.find(identity) if is_barred else None
        if removed is not None:
            reason = "an admin has removed you from the room"
            self.close(removed, CloseCode.REMOVED, reason, now)

    def close(self, connection: Connection, code: CloseCode, reason: str, now: float) -> None:
        """End a connection from this side; one that is lost, for good."""
        if connection.closed is None:
            self._connections.close(connection, code, reason, now)
        elif connection in self._away:
            self._give_up(connection, "removed", now)

    def close_all(self, code: CloseCode, reason: str, now: float) -> None:
        """End every connection, and give up every place."""
        for connection in [*self._connections.open, *self._away]:
            self.close(connection, code, reason, now)

    def handle_timer(self, now: float) -> None:
        """Take those out of their rooms who have been away for too long."""
        for member in [each for each in self._away if each.away_until_s <= now]:
            self._give_up(member, "lost", now)

    def _give_up(self, member: Connection, reason: str, now: float) -> None:
        """Take a peer that is away out of the room."""
        del self._away[member]
        self._depart(member, reason, now)

    def clear_up(self, connection: Connection, now: float) -> None:
        """Clear up after a connection that is over: its last words, its place, the others' view."""
        connections, closed, room = self._connections, connection.closed, connection.room
        if closed is None or not connections.wind_up(connection, now):
            return
        may_come_back = connection.ticket and _is_loss(closed) and not connections.is_draining
        if room is None or not may_come_back:
            self._depart(connection, _farewell(closed), now)
            return
        self._stats.resumes["away"] += 1
        connection.away_until_s = now + connections.config.resume_grace_s
        self._away[connection] = None
        room.forget_receivers()
        away = PeerAway(peer_id=connection.peer_id, is_away=True)
        connections.tell_others(room, connection, away, now)

    def _enter(self, member: Connection, room: Room, joined: Joined, now: float) -> None:
        self.rooms[room.name] = room
        if self.placement is not None and len(room.members) == 1:
            self.placement.note_started(room.name)
        for track in member.peer.tracks:
            muted = room.is_decided(member.peer.identity, track.kind)
            room.streams[track.stream].is_muted = muted
        self._stats.joins += 1
        self._accept(member, room, joined, now)
        tell_others = self._connections.tell_others
        tell_others(room, member, PeerJoined(peer=member.peer), now)
        for number in room.muted_of([member]):
            tell_others(room, member, StreamMuted(stream=number, is_muted=True), now)

    def _place_of(self, join: Join, identity: str | None = None) -> Connection | None:
        """Return whose place a join's secret opens, to this identity if one is given, or None: who
        comes with another's secret neither gets the place nor takes it from its owner."""
        member = self._places.get(_hash_of(join.resume))
        if member is None or member.room is None or member.room.name != join.room:
            return None
        return member if identity in (None, member.peer.identity) else None

    def _forget_ticket(self, connection: Connection) -> None:
        self._places.pop(connection.ticket, None)
        connection.ticket = b""

    def _come_back(
        self, connection: Connection, join: Join, admission: Admission, now: float
    ) -> bool:
        """Let a peer come back to its place, if that is still there and its own."""
        former = self._place_of(join, admission.identity)
        if former is None:
            self._stats.resumes["unknown"] += 1
            return False
        connections, room = self._connections, self.rooms[join.room]
        self._forget_ticket(former)
        if not _has_tracks(former, join):
            # The peer that has the secret does not come as it was: no other will.
            self._stats.resumes["unfit"] += 1
            self.close(former, CloseCode.REPLACED, "your place was given up", now)
            return False
        self._stats.resumes["resumed"] += 1
        if former in self._away:
            del self._away[former]
        else:  # it is dead, which was not noticed yet
            former.session.close(CloseCode.REPLACED, "you have come back on another connection")
            connections.wind_up(former, now)
        former.room = None
        joined = room.come_back(connection, former, admission)
        self._accept(connection, room, joined, now)
        back = PeerAway(peer_id=connection.peer_id, is_away=False)
        connections.tell_others(room, connection, back, now)
        self._note_metadata(connection, join.metadata, now)
        return True

    def _accept(self, member: Connection, room: Room, joined: Joined, now: float) -> None:
        """Tell a peer that it is in, and what else is so in the room."""
        is_kept = member.is_resumable and self._connections.config.resume_grace_s > 0
        if is_kept and self._new_secret is not None:
            secret = self._new_secret()
            member.ticket = _hash_of(secret)
            self._places[member.ticket] = member
            joined = replace(joined, resume=secret)
        member.has_joined = True
        member.session.accept(joined)
        self._connections.flush(member, now)
        for other in room.away:
            self._connections.send(member, PeerAway(peer_id=other.peer_id, is_away=True), now)
        for number in room.muted_of(room.members.values()):
            self._connections.send(member, StreamMuted(stream=number, is_muted=True), now)
        if member.default_every:
            for stream in room.streams.values():
                self._connections.send_newest(member, stream)

    def _replace(
        self, room: Room, connection: Connection, join: Join, identity: str, now: float
    ) -> None:
        """Close the member of an identity that joins again: the newer one wins. A client without an
        identity is known by name and tracks, as one that has crashed and restarted, and takes the
        place of an absent peer alone."""
        former = room.find(identity)
        if not identity and not join.resume:
            absent = (m for m in room.away if m.address == connection.address)
            same = (m for m in absent if m.peer.name == join.name and not m.peer.identity)
            former = next((m for m in same if _has_tracks(m, join)), None)
        if former is not None:
            reason = "you have joined again from elsewhere"
            self.close(former, CloseCode.REPLACED, reason, now)

    def _depart(self, member: Connection, reason: str, now: float) -> None:
        """Take a peer whose connection is over out of the room, if it is in one."""
        self._forget_ticket(member)
        room, member.room = member.room, None
        if room is None:
            return
        room.leave(member)
        if not room.members:
            del self.rooms[room.name]
            if self.placement is not None:
                self.placement.note_ended(room.name)
            return
        for other in room.connected:
            num_dropped = other.outbox.drop(member.peer_id)
            self._connections.note_dropped(num_dropped, "departed")
        news = PeerLeft(peer_id=member.peer_id, reason=reason)
        self._connections.tell_others(room, member, news, now)


def _has_tracks(member: Connection, join: Join) -> bool:
    """Return True if a join has the tracks of a member."""
    return tuple(replace(track, stream=0) for track in member.peer.tracks) == join.tracks


def _is_loss(closed: Closed) -> bool:
    """Return True if a peer was lost to the network, and will try to come back."""
    lost = (CloseCode.CONNECTION_LOST, CloseCode.INTERNAL_ERROR)
    return closed.code == CloseCode.TOO_SLOW or (closed.is_remote and closed.code in lost)


def _farewell(closed: Closed) -> str:
    """Return why a peer is gone in a word that the others may see."""
    if not closed.is_remote:
        return "removed"
    return "left" if closed.code == CloseCode.NORMAL else "lost"


def _hash_of(secret: str) -> bytes:
    return hashlib.sha256(secret.encode()).digest()
