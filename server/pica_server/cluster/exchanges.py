"""Frames between this node and the others of its rooms, and their subscriptions. Pure.

To its hub another node is one more reader of a room: a link with an outbox, see ``cluster_media``.
Here its subscriptions become links, the subscriptions of the peers here are told to it, and what
comes from it goes to the hub.
"""

from collections.abc import Iterator

from pica_protocol.errors import RemoteProtocolError
from pica_protocol.frames import scan_frames
from pica_protocol.session import Media
from pica_server.cluster.media import Exchange, NodeLink
from pica_server.cluster.messages import MEDIA_HEADER_BYTES, Interest, NodeId, decode_media_header
from pica_server.cluster.room import SharedRoom
from pica_server.errors import ClusterMessageError
from pica_server.room.hub import Hub
from pica_server.room.room import Room


class ClusterExchanges:
    """What one node exchanges with the others, room by room."""

    def __init__(self, hub: Hub, me: NodeId) -> None:
        self._hub = hub
        self._me = me
        self._stats = hub.stats
        self._exchanges: dict[str, Exchange] = {}
        self._last_epoch = 0

    def restart(self, me: NodeId) -> None:
        """Be another node from now on, which shares no room yet."""
        self._me = me
        self._exchanges.clear()

    def suspect_loss(self, key: str) -> None:
        """Note that something of a room may have been lost."""
        exchange = self._exchanges.get(key)
        if exchange is not None:
            exchange.suspect_loss()

    def is_due(self, key: str, now: float) -> bool:
        """Say whether ``announce`` has something to say of a room although nothing has happened."""
        exchange = self._exchanges.get(key)
        return exchange is not None and exchange.is_due(now)

    def receive_media(self, key: str, room: Room, data: bytes, now: float) -> bool:
        """Take frames of a room from another node; return whether some before them were lost."""
        exchange = self._exchanges.get(key)
        if exchange is None:
            return False
        try:
            header = decode_media_header(data)
            message = data[MEDIA_HEADER_BYTES:]
            spans = scan_frames(message)
        except (ClusterMessageError, RemoteProtocolError):
            self._stats.cluster["unreadable"] += 1
            return False
        if not exchange.receive_header(header):
            if exchange.is_lossy:
                self._stats.cluster["media_lost"] += 1
            return exchange.is_lossy
        known = [span for span in spans if room.is_remote(span.stream)]
        self._stats.cluster["frames_in"] += len(known)
        self._hub.forwarding.deliver(room, Media(message, known), now, num_here=0)
        return False

    def take_media(self, now: float) -> Iterator[tuple[int, str, bytes]]:
        """Take the media messages that wait: slot of the receiver, room key, bytes. What is not
        taken stays, and is thinned like a slow reader's."""
        for link in list(self._hub.forwarding.ready_links):
            while (taken := link.take(now)) is not None:
                data, num_frames = taken
                self._stats.cluster["frames_out"] += num_frames
                self._stats.cluster["media_out"] += 1
                yield link.slot, link.room_key, data
            self._hub.forwarding.ready_links.pop(link, None)

    def announce(self, shared: SharedRoom, now: float) -> list[tuple[str, Interest]]:
        """Return what the other nodes of a room must be told is wanted of them, and which of
        them."""
        room = self._hub.room(shared.name)
        nodes = shared.nodes
        if room is not None:
            for node in [n for n in room.links if n not in nodes]:
                self._hub.forwarding.drop_link(room, node)
        if room is None or not nodes:
            self._exchanges.pop(shared.key, None)
            return []
        exchange = self._exchanges.get(shared.key)
        if exchange is None:
            self._last_epoch += 1
            exchange = Exchange(shared.key, self._me.name, self._last_epoch)
            self._exchanges[shared.key] = exchange
        layers = room.interest()
        for stream in exchange.layers:
            if stream not in layers:
                room.forget_chain(stream)
        told = exchange.announce(layers, shared.revision, nodes, self._last_epoch + 1, now)
        self._last_epoch += 1
        return told

    def follow(self, shared: SharedRoom, room: Room, interest: Interest, now: float) -> bool:
        """Follow the subscriptions of another node; return whether to tell it ours."""
        exchange = self._exchanges.get(shared.key)
        # Who is not known to be in the room yet will be asked for its subscriptions once it is.
        if exchange is None or interest.node not in shared.nodes:
            return False
        if not exchange.receive_interest(interest):
            return False
        link = room.links.get(interest.node)
        if link is None:
            dropped = self._stats.cluster_dropped
            link = NodeLink(interest.node, self._me.slot, shared.key, dropped)
            room.links[interest.node] = link
        if interest.epoch != link.epoch:
            link.restart(interest.epoch)
        for number, _ in list(room.streams):
            if not room.is_remote(number) and link.want(number, interest.layers.get(number)):
                self._hub.forwarding.resume_link(room, link, number, now)
        return interest.wants_answer
