"""What an admin asks for in a room: remove a participant, mute a kind of stream, bar an identity.

Pure. Only a participant whose token has the grant ``admin`` may ask. Whoever is not in the room any
more is left alone: the request and the leaving have crossed.
"""

from dataclasses import dataclass

from pica_protocol import messages
from pica_protocol.errors import CloseCode
from pica_server.room.connection import Connection
from pica_server.room.connections import Connections
from pica_server.room.forwarding import Forwarding
from pica_server.room.membership import Membership
from pica_server.room.room import BAR, Room


@dataclass(eq=False)
class Moderation:
    """Does what admins ask for in the rooms of one relay."""

    _connections: Connections
    _membership: Membership
    _forwarding: Forwarding

    def receive(self, connection: Connection, asked: messages.Moderation, now: float) -> None:
        """Do what a participant asks for, or close the connection if they may not."""
        room, refuse = connection.room, self._connections.refuse
        assert room is not None  # the session's table: only while joined
        if not connection.is_admin:
            reason = "your token does not let you moderate"
            refuse(connection, "admission", CloseCode.FORBIDDEN, reason, now)
            return
        if not connection.moderations.take(now):
            reason = "you moderate too often"
            refuse(connection, "moderation", CloseCode.TOO_FAST, reason, now)
            return
        match asked:
            case messages.RemovePeer(peer_id=peer_id):
                self.remove(room, peer_id, now)
            case messages.MutePeer(peer_id=peer_id, kind=kind, is_muted=is_muted):
                for track in room.peer(peer_id).tracks if peer_id in room else ():
                    if track.kind == kind:
                        self.mute(room, track.stream, is_muted=is_muted, now=now)
            case messages.BarIdentity(identity=identity, is_barred=is_barred):
                self.bar(room, identity, is_barred=is_barred, now=now)

    def remove(self, room: Room, peer_id: str, now: float) -> None:
        """Remove a participant, who may be away."""
        if peer_id in room:
            reason = "an admin has removed you from the room"
            self._membership.close_peer(peer_id, CloseCode.REMOVED, reason, now)

    def bar(self, room: Room, identity: str, *, is_barred: bool, now: float) -> None:
        """Remove an identity from the room and keep it out until the room is empty, or let it join
        again."""
        room.decide(identity, BAR, holds=is_barred)
        peer_id = room.peer_of(identity)
        if is_barred and peer_id is not None:
            self.remove(room, peer_id, now)

    def mute(self, room: Room, number: int, *, is_muted: bool, now: float) -> None:
        """Stop a stream, or let it go on, and tell everybody. The decision holds for the identity
        of its publisher and for the kind of track."""
        stream = room.stream(number)
        if stream is None or stream.is_muted is is_muted:
            return
        peer = room.peer(stream.publisher)
        kind = next(track.kind for track in peer.tracks if track.stream == number)
        room.decide(peer.identity, kind, holds=is_muted)
        self._forwarding.mute(room, number, stream, is_muted=is_muted, now=now)
