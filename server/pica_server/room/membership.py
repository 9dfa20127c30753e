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
    Moderation,
    MutePeer,
    PeerAway,
    PeerBack,
    PeerJoined,
    PeerLeft,
    PeerUpdated,
    RemovePeer,
    StreamMuted,
    UpdateMetadata,
)
from pica_protocol.session import Closed
from pica_server.limits import MOST_REMEMBERED, RefusalError, TokenBucket
from pica_server.room.connections import (
    CALM_S,
    MODERATION_COST,
    UPDATE_COST,
    Connection,
    Connections,
    Overload,
)
from pica_server.room.room import BAR, Room
from pica_server.tokens import Admission

OWN_JOINS_PER_S: Final = 1.0
OWN_JOINS_BURST: Final = 10.0
"""How often one identity may join, or else one address (chosen: a household behind one address
comes together, and a page that is loaded again and again is no attack)."""


class Placement(Protocol):
    """Finds the relay of a room that is not here, and tells `Membership.follow`; see
    `pica_server.placement`."""

    is_up: bool

    def ask(self, room: str) -> None:
        """Find the relay of a room that is not here."""

    def note_started(self, room: str) -> None:
        """Note that a room has got its first peer here."""

    def note_ended(self, room: str) -> None:
        """Note that the last peer has left a room."""

    def refuge(self) -> str:
        """Return the address of another relay for the peers of a room, "" if there is none."""


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
        # The last connection of those who are away, in the order of their going.
        self._away: dict[str, Connection] = {}
        self._places: dict[bytes, str] = {}  # peers by the hash of the secret
        self._joins: TokenBucket | None = None  # full when the first one comes
        # By identity, or else by address; drops the oldest.
        self._own_joins: dict[str, TokenBucket] = {}
        self.placement: Placement | None = None
        # Joins that wait until the relay of their room is known, at most one for each connection.
        self._waiting: dict[str, list[tuple[Connection, Join, Admission]]] = {}
        self._connections.on_over = self.clear_up

    def join(self, connection: Connection, join: Join, now: float) -> None:
        """Let a peer into a room, or close it."""
        limits, refuse = self._connections.config.limits, self._connections.refuse
        if connection.is_crowded and self._place_of(join) is None:
            reason = f"{limits.connections_per_address} connections from one address"
            refuse(connection, "address", CloseCode.TOO_MANY, reason, now)
            return
        # First of all: who has no token must not use up the joins of those who have one.
        try:
            admission = self._admit(join)
        except RefusalError as error:
            refuse(connection, "admission", error.code, str(error), now)
            return
        place = self._place_of(join, admission.identity)
        payer = admission.identity or place or connection.address
        if not self._may_join(payer, now, is_back=place is not None):
            reason = "too many join at once, try again"
            refuse(connection, "joins", CloseCode.BUSY, reason, now)
            return
        if self.placement is None or join.room in self.rooms:
            self._let_in(connection, join, admission, now)
            return
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
            self._let_in(connection, join, admission, now)

    def send_elsewhere(
        self, room_name: str, waiting: Sequence[Connection], url: str, now: float
    ) -> None:
        """Redirect the peers of a room, and joins that wait for it."""
        room, connections = self.rooms.get(room_name), self._connections
        inside = [] if room is None else connections.connected(room)
        connections.send_elsewhere([*waiting, *inside], now, url)
        if room is not None:
            self.give_up_away(room, "lost", now)

    def _let_in(self, connection: Connection, join: Join, admission: Admission, now: float) -> None:
        """Let a peer into a room of this relay, or close it."""
        refuse = self._connections.refuse
        connection.is_resumable = join.resumable
        if join.resume and self._come_back(connection, join, admission, now):
            return
        room = self.rooms.get(join.room)
        is_late = self._overload.refuses(now)
        if is_late and (room is None or room.peer_of(admission.identity) is None):
            reason = f"the relay has too much to do, try again in {CALM_S:g} s"
            refuse(connection, "late", CloseCode.BUSY, reason, now)
            return
        self._replace(connection, join, admission.identity, now)
        if room is not None and room.is_decided(admission.identity):
            reason = "an admin has barred you until the room is empty"
            refuse(connection, "admission", CloseCode.FORBIDDEN, reason, now)
            return
        self._make_place(join.room, now)
        room = self._room(join.room)
        if room.is_full:
            reason = f"room {join.room} is full: {self._connections.config.room_capacity} peers"
            refuse(connection, "room", CloseCode.ROOM_FULL, reason, now)
            return
        joined = room.join(connection.peer_id, join, admission)
        self._enter(connection, room, joined, admission, now)

    def update_metadata(self, connection: Connection, update: UpdateMetadata, now: float) -> None:
        """Note what a peer says of itself, and tell the others."""
        room, metadata, connections = connection.room, update.metadata, self._connections
        assert room is not None
        if not connection.told.take(now, UPDATE_COST):
            reason = "metadata changes too often"
            connections.refuse(connection, "metadata", CloseCode.TOO_FAST, reason, now)
        elif room.update_metadata(connection.peer_id, metadata):
            news = PeerUpdated(peer_id=connection.peer_id, metadata=metadata)
            connections.tell_others(room, connection.peer_id, news, now)

    def moderate(self, connection: Connection, asked: Moderation, now: float) -> None:
        """Do what an admin asks for, or close who may not ask. A participant who is not in the room
        any more is left alone: the request and the leaving have crossed."""
        room, refuse = connection.room, self._connections.refuse
        assert room is not None  # the session's table: only while joined
        if not connection.is_admin:
            reason = "your token does not let you moderate"
            refuse(connection, "admission", CloseCode.FORBIDDEN, reason, now)
            return
        if not connection.told.take(now, MODERATION_COST):
            reason = "you moderate too often"
            refuse(connection, "moderation", CloseCode.TOO_FAST, reason, now)
            return
        removed: str | None = None
        match asked:
            case RemovePeer(peer_id=peer_id):
                removed = peer_id
            case MutePeer(peer_id=peer_id, kind=kind, is_muted=is_muted) if peer_id in room:
                peer = room.peer(peer_id)
                for track in peer.tracks:
                    stream = room.streams.get(track.stream)
                    if track.kind == kind and stream and stream.is_muted is not is_muted:
                        room.decide(peer.identity, kind, holds=is_muted)
                        number = track.stream
                        self._connections.mute(room, number, stream, is_muted=is_muted, now=now)
            case BarIdentity(identity=identity, is_barred=is_barred):
                room.decide(identity, BAR, holds=is_barred)
                removed = room.peer_of(identity) if is_barred else None
        if removed is not None and removed in room:
            reason = "an admin has removed you from the room"
            self.close_peer(removed, CloseCode.REMOVED, reason, now)

    def close(self, connection: Connection, code: CloseCode, reason: str, now: float) -> None:
        """End a connection from this side; one that is lost, for good."""
        if connection.closed is None:
            self._connections.close(connection, code, reason, now)
        elif self._away.get(connection.peer_id) is connection:
            self.give_up(connection.peer_id, "removed", now)

    def close_all(self, code: CloseCode, reason: str, now: float) -> None:
        """End every connection, and give up every place."""
        for connection in [*self._connections.by_peer.values(), *self._away.values()]:
            self.close(connection, code, reason, now)

    def close_peer(self, peer_id: str, code: CloseCode, reason: str, now: float) -> None:
        """Put a peer out, whether it is away or not."""
        connection = self._connections.by_peer.get(peer_id) or self._away[peer_id]
        self.close(connection, code, reason, now)

    def handle_timer(self, now: float) -> None:
        """Take those out of their rooms who have been away for too long."""
        for peer_id, connection in list(self._away.items()):
            if connection.away_until_s <= now:
                self.give_up(peer_id, "lost", now)

    def give_up(self, peer_id: str, reason: str, now: float) -> None:
        """Take a peer that is away out of the room."""
        self._depart(self._away.pop(peer_id), reason, now)

    def give_up_away(self, room: Room, reason: str, now: float) -> None:
        """Take all who are away out of a room."""
        for peer_id in room.away:
            self.give_up(peer_id, reason, now)

    def clear_up(self, connection: Connection, now: float) -> None:
        """Clear up after a connection that is over: its last words, its place, the others' view."""
        connections = self._connections
        if not connections.wind_up(connection, now):
            return
        closed = connection.closed
        assert closed is not None
        room, peer_id, reason = connection.room, connection.peer_id, _farewell(closed)
        may_come_back = connection.ticket and _is_loss(closed) and not connections.is_draining
        if room is not None and may_come_back:
            self._stats.resumes["away"] += 1
            connection.away_until_s = now + connections.config.resume_grace_s
            self._away[peer_id] = connection
            room.go_away(peer_id)
            connections.tell_others(room, peer_id, PeerAway(peer_id=peer_id), now)
            return
        self._depart(connection, reason, now)

    def _room(self, name: str) -> Room:
        room = self.rooms.get(name)
        return Room(name, self._connections.config.room_capacity) if room is None else room

    def _enter(
        self, connection: Connection, room: Room, joined: Joined, admission: Admission, now: float
    ) -> None:
        self.rooms[room.name] = room
        if self.placement is not None and len(room) == 1:
            self.placement.note_started(room.name)
        peer = room.peer(connection.peer_id)
        for track in peer.tracks:
            stream = room.streams.get(track.stream)
            assert stream is not None
            stream.is_muted = room.is_decided(peer.identity, track.kind)
        self._stats.joins += 1
        self._accept(connection, room, joined, admission, now)
        tell_others = self._connections.tell_others
        tell_others(room, peer.peer_id, PeerJoined(peer=peer), now)
        for number in room.muted_of(peer.peer_id):
            tell_others(room, peer.peer_id, StreamMuted(stream=number, is_muted=True), now)
        if admission.may_subscribe:
            self._connections.catch_up(connection, room)

    def _place_of(self, join: Join, identity: str | None = None) -> str | None:
        """Return whose place a join's secret opens, to this identity if one is given, or None: who
        comes with another's secret neither gets the place nor takes it from its owner."""
        peer_id, room = self._places.get(_hash_of(join.resume), ""), self.rooms.get(join.room)
        if room is None or peer_id not in room:
            return None
        return peer_id if identity in (None, room.peer(peer_id).identity) else None

    def _forget_ticket(self, connection: Connection) -> None:
        self._places.pop(connection.ticket, None)
        connection.ticket = b""

    def _come_back(
        self, connection: Connection, join: Join, admission: Admission, now: float
    ) -> bool:
        """Let a peer come back to its place, if that is still there and its own."""
        peer_id = self._place_of(join, admission.identity)
        if peer_id is None:
            self._stats.resumes["unknown"] += 1
            return False
        connections, room = self._connections, self.rooms[join.room]
        lost = self._away.get(peer_id)
        former = connections.by_peer[peer_id] if lost is None else lost
        self._forget_ticket(former)
        if not room.is_place_of(peer_id, admission.identity, join.tracks):
            # The peer that has the secret does not come as it was: no other will.
            self._stats.resumes["unfit"] += 1
            self.close(former, CloseCode.REPLACED, "your place was given up", now)
            return False
        self._stats.resumes["resumed"] += 1
        self._away.pop(peer_id, None)
        if lost is None:  # it is dead, which was not noticed yet
            former.room = None
            former.session.close(CloseCode.REPLACED, "you have come back on another connection")
            connections.wind_up(former, now)
        connections.rename(connection, peer_id)
        joined = room.come_back(peer_id, may_subscribe=admission.may_subscribe)
        self._accept(connection, room, joined, admission, now)
        connections.tell_others(room, peer_id, PeerBack(peer_id=peer_id), now)
        if room.update_metadata(peer_id, join.metadata):
            news = PeerUpdated(peer_id=peer_id, metadata=join.metadata)
            connections.tell_others(room, peer_id, news, now)
        if admission.may_subscribe:
            self._connections.catch_up(connection, room)
        return True

    def _accept(
        self, connection: Connection, room: Room, joined: Joined, admission: Admission, now: float
    ) -> None:
        """Tell a peer that it is in, and what else is so in the room."""
        connection.room, connection.is_admin = room, admission.may_admin
        joined = replace(joined, is_admin=admission.may_admin)
        is_kept = connection.is_resumable and self._connections.config.resume_grace_s > 0
        if is_kept and self._new_secret is not None:
            secret = self._new_secret()
            connection.ticket = _hash_of(secret)
            self._places[connection.ticket] = connection.peer_id
            joined = replace(joined, resume=secret)
        connection.has_joined = True
        connection.session.accept(joined)
        self._connections.flush(connection, now)
        for peer_id in room.away:
            self._connections.send(connection, PeerAway(peer_id=peer_id), now)
        for number, stream in list(room.streams.items()):
            if stream.is_muted:
                self._connections.send(connection, StreamMuted(stream=number, is_muted=True), now)

    def _make_place(self, room_name: str, now: float) -> None:
        """If a room is full, give up the place of who has been away longest in it and has no
        identity: else a peer that comes and drops connections keeps a room full of absent ones."""
        room = self.rooms.get(room_name)
        if room is not None and room.is_full:
            nobodies = [p for p in self._away if p in room and not room.peer(p).identity]
            for peer_id in nobodies[:1]:
                self.give_up(peer_id, "lost", now)

    def _replace(self, connection: Connection, join: Join, identity: str, now: float) -> None:
        """Close who is here under an identity that joins again: the newer one wins. Who has none is
        known by what they say, and takes the place of an absent peer alone."""
        room = self.rooms.get(join.room)
        if room is None:
            return
        peer_id = room.peer_of(identity)
        if not identity and not join.resume:
            before = (lost for each in room.away if (lost := self._away[each]))
            same = (lost.peer_id for lost in before if lost.address == connection.address)
            peer_id = next((each for each in same if room.is_like(each, join)), None)
        if peer_id is not None:
            reason = "you have joined again from elsewhere"
            self.close_peer(peer_id, CloseCode.REPLACED, reason, now)

    def _depart(self, connection: Connection, reason: str, now: float) -> None:
        """Take a peer whose connection is over out of the room, if it is in one."""
        self._forget_ticket(connection)
        room, connection.room = connection.room, None
        if room is not None:
            self._forget(room, connection.peer_id, reason, now)

    def _forget(self, room: Room, peer_id: str, reason: str, now: float) -> None:
        """Clear up after a member of a room, and tell the others."""
        room.leave(peer_id)
        if len(room) == 0:
            del self.rooms[room.name]
            if self.placement is not None:
                self.placement.note_ended(room.name)
            return
        self._connections.forget_peer(room, peer_id)
        news = PeerLeft(peer_id=peer_id, reason=reason)
        self._connections.tell_others(room, peer_id, news, now)


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
