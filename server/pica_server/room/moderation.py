"""What an admin does to rooms: put peers out, close rooms, stop streams. Pure.

What must be done on another node of the cluster is passed on to it. What is to hold when its owner
comes again is kept in `Rulings`.
"""

from collections.abc import Set
from dataclasses import dataclass

from pica_protocol.errors import CloseCode
from pica_server.room.connections import Connections
from pica_server.room.forwarding import Forwarding
from pica_server.room.membership import Membership
from pica_server.room.room import Room
from pica_server.room.rulings import BAR, RULING_S, Rulings, Subject, identity_key


@dataclass(eq=False)
class Moderation:
    """The admin's hand in the rooms of one relay."""

    _connections: Connections
    _membership: Membership
    _forwarding: Forwarding
    _rulings: Rulings

    def remove(self, room_name: str, peer_id: str, *, now: float) -> bool:
        """Put a peer out of its room, who may be away; return whether it was there, in a room that
        has peers on this node."""
        room = self._membership.rooms.get(room_name)
        if room is None or peer_id not in room:
            return False
        if room.node_of(peer_id):
            self._order(room, "remove", peer_id)
            return True
        reason = "an admin has removed you"
        self._membership.close_peer(peer_id, CloseCode.REMOVED, reason, now)
        return True

    def bar(
        self,
        room_name: str,
        identity: str,
        *,
        is_barred: bool = True,
        lasts_s: float = RULING_S,
        now: float,
    ) -> bool:
        """Put an identity out of a room and keep it out, or let it come again.

        Args:
            room_name: The room, which may be empty; in a cluster, one with peers on this node.
            identity: Who; nobody is barred by the empty one.
            lasts_s: For how long, seconds.

        Returns:
            Whether it holds: there are identities only where there are tokens.
        """
        holds = self._rulings.give(room_name, identity, holds=is_barred, lasts_s=lasts_s)
        if self._connections.cluster_peers is not None:
            self._connections.cluster_peers.note_rulings(room_name)
        self.enforce(room_name, {(identity_key(identity), BAR)}, now)
        return holds

    def enforce(self, room_name: str, news: Set[Subject], now: float) -> None:
        """Do to those who are on this node what rulings say of which there is news."""
        room = self._membership.rooms.get(room_name)
        for peer in () if room is None else room.peers_here:
            assert room is not None
            if peer.peer_id not in room:
                continue  # putting one out may put out others, who read too slowly
            who = identity_key(peer.identity)
            if (who, BAR) in news and self._rulings.holds(room_name, peer.identity):
                self.remove(room_name, peer.peer_id, now=now)
                continue
            for track in peer.tracks:
                is_news = (who, track.kind) in news
                if is_news and self._rulings.holds(room_name, peer.identity, track.kind):
                    self.mute(room_name, track.stream, is_muted=True, now=now)

    def close_room(self, room_name: str, now: float, *, everywhere: bool = True) -> int | None:
        """Put everybody out of a room, on all nodes or on this one alone; return how many were on
        this one, or None: nobody was."""
        room = self._membership.rooms.get(room_name)
        if room is None:
            return None
        if everywhere:
            self._order(room, "close", "")
        num_peers = len(room)
        connections = self._connections.connected(room)
        reason = "an admin has closed the room"
        self._connections.close_together(connections, CloseCode.ROOM_CLOSED, reason, now)
        self._membership.give_up_away(room, "removed", now)
        return num_peers

    def mute(self, room_name: str, number: int, *, is_muted: bool, now: float) -> bool:
        """Stop a stream, or let it go on, and tell everybody; return whether it is there. It stays
        so when its owner joins again, if they have an identity."""
        room = self._membership.rooms.get(room_name)
        stream = None if room is None else room.stream(number)
        if room is None or stream is None:
            return False
        if stream.is_muted is is_muted:
            return True
        if room.is_remote(number):
            self._order(room, "mute" if is_muted else "unmute", str(number))
            return True
        peer = room.peer(stream.publisher)
        kind = next(track.kind for track in peer.tracks if track.stream == number)
        self._rulings.give(room_name, peer.identity, kind, holds=is_muted)
        self._forwarding.mute(room, number, stream, is_muted=is_muted, now=now)
        if self._connections.cluster_peers is not None:
            self._connections.cluster_peers.note_member(room, stream.publisher)
        return True

    def _order(self, room: Room, what: str, target: str) -> None:
        """Have something done where it must be, if there are other nodes."""
        if self._connections.cluster_peers is not None:
            self._connections.cluster_peers.order(room, what, target)
