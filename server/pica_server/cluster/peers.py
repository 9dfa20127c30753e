"""What a hub asks of the other nodes of its cluster; without a cluster there are none. Pure."""

from typing import Protocol

from pica_protocol.messages import Join, Whisper
from pica_server.auth.tokens import Admission
from pica_server.room.connection import Connection
from pica_server.room.room import Room


class ClusterPeers(Protocol):
    """The other nodes, as the hub sees them; `pica_server.cluster.node` is the real thing.

    Nothing here calls the hub back at once: what comes of it comes later.
    """

    @property
    def trouble(self) -> str:
        """What is wrong between this node and the others, in a few words, or empty."""

    @property
    def num_nodes(self) -> int:
        """How many nodes there are, this one included."""

    def join(self, connection: Connection, join: Join, admission: Admission, now: float) -> None:
        """Find a place for somebody who is admitted; the hub lets them in, or closes them."""

    def leave(self, connection: Connection, reason: str) -> None:
        """Note that somebody has gone, or does not wait for a place any more."""

    def come_back(self, connection: Connection, room: Room) -> None:
        """Note that somebody has come back to their place, on a new connection; ``leave`` was not
        called."""

    def note_member(self, room: Room, peer_id: str) -> None:
        """Note that something is different about a peer of this node."""

    def order(self, room: Room, what: str, target: str) -> None:
        """Have something done where it must be: ``remove`` a peer, ``mute`` or ``unmute`` a stream,
        ``bar`` or ``unbar`` an identity on all other nodes."""

    def note_subscriptions(self, room: Room) -> None:
        """Note that a peer in the room may want something else of the others than before."""

    def ask_for_keyframe(self, room: Room, publisher: str, stream: int, why: str) -> None:
        """Ask a publisher on another node for a keyframe."""

    def whisper(self, room: Room, sender: str, whisper: Whisper) -> bool:
        """Send a whisper to a peer on another node; False if there is no such peer."""
