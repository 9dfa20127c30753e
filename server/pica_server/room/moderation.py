"""What an admin does to rooms: put peers out, close rooms, stop streams. Pure.

What must be done on another node of the cluster is passed on to it.
"""

from pica_protocol.errors import CloseCode
from pica_server.room.connections import Connections
from pica_server.room.forwarding import Forwarding
from pica_server.room.membership import Membership
from pica_server.room.room import Room

MAX_BARRED = 256
"""Identities that a room remembers to keep out; drops the oldest (chosen)."""


class Moderation:
    """The admin's hand in the rooms of one relay."""

    def __init__(
        self, connections: Connections, membership: Membership, forwarding: Forwarding
    ) -> None:
        self._connections = connections
        self._membership = membership
        self._forwarding = forwarding

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
        room = self._membership.rooms.get(room_name)
        if room is None or peer_id not in room:
            return False
        if room.node_of(peer_id):
            self._order(room, "bar" if bar else "remove", peer_id)
            return True
        if bar:
            identity = room.identity_of(peer_id)
            room.bar(identity, MAX_BARRED)
            if self._connections.cluster_peers is not None:
                self._connections.cluster_peers.bar(room, identity)
        reason = "an admin has removed you"
        self._membership.close_peer(peer_id, CloseCode.REMOVED, reason, now)
        return True

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
        """Stop a stream, or let it go on, and tell everybody; return whether it is there."""
        room = self._membership.rooms.get(room_name)
        stream = None if room is None else room.stream(number)
        if room is None or stream is None:
            return False
        if stream.is_muted is is_muted:
            return True
        if room.is_remote(number):
            self._order(room, "mute" if is_muted else "unmute", str(number))
            return True
        self._forwarding.mute(room, number, stream, is_muted=is_muted, now=now)
        if self._connections.cluster_peers is not None:
            self._connections.cluster_peers.note_member(room, stream.publisher)
        return True

    def _order(self, room: Room, what: str, target: str) -> None:
        """Have something done where it must be, if there are other nodes."""
        if self._connections.cluster_peers is not None:
            self._connections.cluster_peers.order(room, what, target)
