"""One node of a cluster: the rooms it shares, and what passes between its hub and the others.

Pure. The shell tells the node what NATS brought (``receive_*``), calls ``step`` after anything has
happened, here or there, and then does what ``take_commands`` and ``exchanges.take_media`` say. The
node tells its hub who may come in, who is in a room elsewhere, and which frames came from there.
"""

from dataclasses import dataclass, replace
from typing import Final

from pica_protocol.errors import CloseCode
from pica_protocol.messages import Join, Whisper
from pica_server.auth.tokens import Admission
from pica_server.cluster import messages
from pica_server.cluster.exchanges import ClusterExchanges
from pica_server.cluster.liveness import Liveness, Standing
from pica_server.cluster.room import (
    Admitted,
    Answer,
    Arrived,
    Changed,
    Departed,
    Heard,
    Refused,
    Replaced,
    Request,
    SharedRoom,
    SharedRoomEvent,
)
from pica_server.errors import ClusterMessageError
from pica_server.room.connection import Connection
from pica_server.room.hub import Hub
from pica_server.room.room import Room, as_peer

TICK_S: Final = 0.25
"""Between two looks at who lives."""


@dataclass(frozen=True, slots=True)
class Watch:
    """Hear of every change of a record from now on."""

    key: str


@dataclass(frozen=True, slots=True)
class Unwatch:
    """Do not hear of it any more."""

    key: str


@dataclass(frozen=True, slots=True)
class Tell:
    """Send a message to a node."""

    slot: int
    data: bytes


Command = Watch | Unwatch | Tell | Request


@dataclass(slots=True)
class _Place:
    """Who is in a room here, or waits to be."""

    connection: Connection
    shared: SharedRoom
    admission: Admission


class ClusterNode:
    """The cluster as one hub's cluster_peers; see `pica_server.cluster.peers`.

    Attributes:
        me: This node, as the others know it.
        exchanges: Holds the frames that wait for others.
    """

    def __init__(self, hub: Hub, me: messages.NodeId, capacity: int, now: float) -> None:
        """Begin with a lease that was confirmed just now; ``capacity`` is of one room."""
        self.liveness = Liveness(now)
        self._hub = hub
        self.me = me
        self._capacity = capacity
        self._stats = hub.stats
        self.standing = Standing.CLUSTERED
        self._rooms: dict[str, SharedRoom] = {}
        self.exchanges = ClusterExchanges(hub, me)
        self._places: dict[str, _Place] = {}  # bounded by the number of connections
        self._dirty: dict[str, None] = {}
        self._commands: list[Command] = []
        self._last_stream = 0
        self._tick_s = now + TICK_S
        self._alive: list[str] = []

    @property
    def num_rooms(self) -> int:
        """Rooms whose records hold peers of this node, or may."""
        return len(self._rooms)

    @property
    def num_nodes(self) -> int:
        """Nodes that live, this one included."""
        return 1 if self.standing is Standing.LOCAL else 1 + len(self._alive)

    @property
    def trouble(self) -> str:
        """What is wrong, in a few words, or empty."""
        match self.standing:
            case Standing.CLUSTERED:
                return ""
            case Standing.UNCERTAIN:
                return "cluster uncertain, joins wait"
            case Standing.LOCAL:
                return "cluster lost, rooms are local"

    # What the hub says.

    def join(self, connection: Connection, join: Join, admission: Admission, now: float) -> None:
        """Find a place for somebody; see `ClusterPeers`."""
        shared = self._room(join.room)
        tracks = tuple(replace(t, stream=self._new_stream(shared)) for t in join.tracks)
        self._places[connection.peer_id] = _Place(connection, shared, admission)
        shared.join(as_peer(connection.peer_id, join, admission, tracks), now)
        self._dirty[shared.key] = None

    def leave(self, connection: Connection, reason: str) -> None:
        """Note that somebody has gone; see `ClusterPeers`."""
        place = self._places.pop(connection.peer_id, None)
        if place is not None:
            place.shared.leave(connection.peer_id, reason)
            self._dirty[place.shared.key] = None

    def come_back(self, connection: Connection, room: Room) -> None:
        """Note that somebody has come back; see `ClusterPeers`."""
        place = self._places.get(connection.peer_id)
        if place is not None:
            place.connection = connection
        self.note_subscriptions(room)

    def note_member(self, room: Room, peer_id: str) -> None:
        """Note that something is different about a peer; see `ClusterPeers`."""
        place = self._places.get(peer_id)
        if place is not None:
            peer = room.peer(peer_id)
            place.shared.update(peer, is_away=peer_id in room.away, muted=room.muted_of(peer_id))
            self._dirty[place.shared.key] = None

    def order(self, room: Room, what: str, target: str) -> None:
        """Have something done elsewhere; see `ClusterPeers`."""
        key = messages.room_key(room.name)
        shared = self._rooms.get(key)
        if shared is None:
            return
        if what in ("bar", "unbar"):
            nodes = shared.nodes
        elif what in ("mute", "unmute"):
            stream = room.stream(int(target))
            nodes = set() if stream is None else {room.node_of(stream.publisher)}
        else:
            nodes = {room.node_of(target)}
        for node in sorted(nodes):
            self._tell(node, messages.Order(key, what, target))

    def note_subscriptions(self, room: Room) -> None:
        """Look at what the peers here want; see `ClusterPeers`."""
        self._dirty[messages.room_key(room.name)] = None

    def ask_for_keyframe(self, room: Room, publisher: str, stream: int, why: str) -> None:
        """Ask a publisher elsewhere; see `ClusterPeers`."""
        self._tell(room.node_of(publisher), messages.Ask(messages.room_key(room.name), stream, why))

    def whisper(self, room: Room, sender: str, whisper: Whisper) -> bool:
        """Send a whisper elsewhere; see `ClusterPeers`."""
        node = room.node_of(whisper.peer_id)
        if node:
            self._tell(node, messages.Passed(messages.room_key(room.name), sender, whisper))
        return bool(node)

    # What NATS brought.

    def receive_reconnected(self, now: float) -> None:
        """Note that the connection was lost for a while, and all that was said meanwhile with
        it. No record is read before the lease is confirmed: NATS may have come back without the
        store, and NATS 2.9 dies of a request for a record of a store that is being made."""
        self._count("reconnected")
        self.liveness.doubt()
        self._look(now)
        self.receive_loss_of_all()

    def receive_loss(self, key: str) -> None:
        """Note that news of a room may have been lost."""
        shared = self._rooms.get(key)
        if shared is not None:
            shared.doubt()
            self._dirty[key] = None
            if shared.exchange is not None:
                shared.exchange.suspect_loss()

    def receive_loss_of_all(self) -> None:
        """Note that news of any room may have been lost."""
        for key in self._rooms:
            self.receive_loss(key)

    def receive_lease(self, slot: str, data: bytes, now: float) -> None:
        """Take news of a lease: the name of the node that renewed it, or nothing if it was given
        up."""
        name = data.decode("ascii", "replace")
        if data and name != self.me.name:
            self.liveness.receive_beat(name, now)
            if name not in self._alive:
                self._look(now)
            self._dirty |= {key: None for key, each in self._rooms.items() if each.is_unsettled}
        elif not data:
            for node in self.liveness.alive(now):
                if node.partition("-")[0] == slot:
                    self.liveness.forget(node)
            self._look(now)

    def receive_renewed(self, sent_s: float, now: float) -> None:
        """Note that this node's lease was confirmed."""
        self.liveness.receive_renewed(sent_s, now)
        self._look(now)

    def receive_record(self, key: str, data: bytes, revision: int, now: float) -> None:
        """Take news of a room's record."""
        shared = self._rooms.get(key)
        if shared is None:
            return
        try:
            shared.receive_record(data, revision, now)
        except ClusterMessageError:
            self._count("unreadable")
        self._pass_on(shared, now)
        self._dirty[key] = None

    def receive_answer(self, key: str, ticket: int, answer: Answer, now: float) -> None:
        """Take the answer to a request."""
        shared = self._rooms.get(key)
        if shared is not None:
            self._count(type(answer).__name__.lower())
            shared.receive_answer(ticket, answer, now)
            self._pass_on(shared, now)
            self._dirty[key] = None

    def receive_node_message(self, data: bytes, now: float) -> None:
        """Take what another node said to this one."""
        try:
            message = messages.decode_node_message(data)
        except ClusterMessageError:
            self._count("unreadable")
            return
        shared = self._rooms.get(message.room)
        room = None if shared is None else self._hub.room(shared.name)
        if shared is None or room is None or self.standing is Standing.LOCAL:
            return
        match message:
            case messages.Interest():
                self._follow(shared, room, message, now)
            case messages.Ask(stream=stream, why=why):
                if not room.is_remote(stream):
                    self._hub.forwarding.ask_for_keyframe(room, stream, why, now)
            case messages.Order():
                self._obey(room, message, now)
            case messages.Passed(sender=sender, whisper=whisper):
                if room.node_of(sender):
                    self._hub.forwarding.pass_whisper(room, sender, whisper, now)

    def receive_media(self, key: str, data: bytes, now: float) -> None:
        """Take frames from another node."""
        shared = self._rooms.get(key)
        room = None if shared is None else self._hub.room(shared.name)
        if shared is None or room is None:
            return
        if self.exchanges.receive_media(shared, room, data, now):
            self._dirty[key] = None

    # What must be done.

    def next_timer(self) -> float:
        """Return when ``handle_timer`` is due."""
        return self._tick_s

    def handle_timer(self, now: float) -> None:
        """Look at who lives."""
        if now >= self._tick_s:
            self._tick_s = now + TICK_S
            self._look(now)

    def restart(self, me: messages.NodeId, now: float) -> None:
        """Be another node: the slot has been given away while this one was cut off.

        Its streams may be somebody else's now, so all who are in a room must come anew.
        """
        self._count("restarted")
        for place in list(self._places.values()):
            reason = "this relay was away for too long, come again"
            self._hub.close(place.connection, CloseCode.GOING_AWAY, reason, now)
        self._commands += [Unwatch(key) for key in self._rooms]
        self._rooms.clear()
        self._dirty.clear()
        self.me = self.exchanges.me = me
        self.liveness = Liveness(now)
        self._look(now)

    def step(self, now: float) -> None:
        """Bring every room where something has happened up to date."""
        while self._dirty:
            key = next(iter(self._dirty))
            del self._dirty[key]
            shared = self._rooms.get(key)
            if shared is None:
                continue
            shared.advance(self.standing, self.liveness, now)
            self._pass_on(shared, now)
            request = shared.take_request()
            if request is not None:
                self._commands.append(request)
            for node, interest in self.exchanges.announce(shared, now):
                self._tell(node, interest)
            if shared.is_over and key not in self._dirty:
                del self._rooms[key]
                self._commands.append(Unwatch(key))

    def take_commands(self) -> list[Command]:
        """Take what the shell has to do."""
        commands, self._commands = self._commands, []
        return commands

    def _pass_on(self, shared: SharedRoom, now: float) -> None:
        """Tell the hub at once what has come out about a room: whoever leaves before the next step
        is then in the same room here and there."""
        for event in shared.take_events():
            self._handle(shared, event, now)

    def _handle(self, shared: SharedRoom, event: SharedRoomEvent, now: float) -> None:
        match event:
            case Admitted(peer=peer):
                place = self._places.get(peer.peer_id)
                if place is None:  # gone meanwhile: the record must hear of it
                    shared.leave(peer.peer_id, "left")
                    self._dirty[shared.key] = None
                else:
                    self._hub.membership.enter(
                        place.connection, shared.name, peer, place.admission, now
                    )
            case Refused(peer_id=peer_id):
                place = self._places.get(peer_id)
                if place is not None:
                    self._hub.membership.refuse(place.connection, shared.name, now)
            case Replaced(peer_id=peer_id):
                place = self._places.get(peer_id)
                if place is not None:
                    reason = "you have joined again from elsewhere"
                    self._hub.close(place.connection, CloseCode.REPLACED, reason, now)
            case Arrived(member=member):
                self._hub.membership.arrive(shared.name, member.node, member.peer, now)
                self._hub.membership.follow(
                    shared.name, messages.Member(member.node, member.peer), member, now
                )
            case Changed(before=before, member=member):
                self._hub.membership.follow(shared.name, before, member, now)
            case Departed(peer_id=peer_id, reason=reason):
                self._hub.membership.depart(shared.name, peer_id, reason, now)
            case Heard(node=node):
                self.liveness.receive_beat(node, now)

    def _follow(
        self, shared: SharedRoom, room: Room, interest: messages.Interest, now: float
    ) -> None:
        """Follow the subscriptions of another node."""
        if interest.revision > shared.revision and shared.revision > 0:
            shared.doubt()  # news was lost
            self._dirty[shared.key] = None
        if self.exchanges.follow(shared, room, interest, now):
            self._dirty[shared.key] = None

    def _obey(self, room: Room, order: messages.Order, now: float) -> None:
        """Do what an admin wants who has asked another node."""
        match order.what:
            case "bar" | "unbar":
                is_barred = order.what == "bar"
                self._hub.moderation.bar(room, order.target, is_barred=is_barred, now=now)
            case "mute" | "unmute" if order.target.isdigit():
                number, is_muted = int(order.target), order.what == "mute"
                if not room.is_remote(number):
                    self._hub.moderation.mute(room, number, is_muted=is_muted, now=now)
            case "remove" if not room.node_of(order.target):
                self._hub.moderation.remove(room, order.target, now)

    def _look(self, now: float) -> None:
        """See who lives, and what this node is; bring rooms up to date that depend on it."""
        standing = self.liveness.standing(now)
        alive = self.liveness.alive(now)
        has_changed = standing is not self.standing or alive != self._alive
        if standing is not self.standing:
            self._count(standing.value)
        self.standing, self._alive = standing, alive
        for key, shared in self._rooms.items():
            is_due = shared.exchange is not None and shared.exchange.is_due(now)
            if has_changed or shared.is_unsettled or is_due:
                self._dirty[key] = None

    def _room(self, name: str) -> SharedRoom:
        shared = SharedRoom(name, self._capacity, self.me)
        found = self._rooms.setdefault(shared.key, shared)
        if found is shared:
            self._commands.append(Watch(shared.key))
        return found

    def _new_stream(self, shared: SharedRoom) -> int:
        # Counting up over all rooms: a late frame of a departed peer must not find a new owner.
        while True:
            self._last_stream = self._last_stream % (messages.STREAMS_PER_SLOT - 1) + 1
            stream = self.me.slot * messages.STREAMS_PER_SLOT + self._last_stream
            if not shared.uses(stream):
                return stream

    def _tell(self, node: str, message: messages.NodeMessage) -> None:
        if node:
            self._commands.append(
                Tell(messages.slot_of(node), messages.encode_node_message(message))
            )

    def _count(self, what: str) -> None:
        self._stats.cluster[what] += 1
