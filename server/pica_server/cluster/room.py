"""One room that lives on several nodes: who is in it, as all of them agree. Pure.

All nodes share one record of the room, kept under a revision. Only one write for each revision
succeeds, so the record has one history, and whoever is in it has a place. A node

- keeps its own peers in the record, adds those who ask while there are places, and takes those away
  who have gone; it never touches peers of another node that lives, save one of the same identity
  that joins here: the newer one wins;
- takes the peers of a dead node out, the first living node of the record at once, any other along
  with its next write;
- removes the record only together with the last peer in it;
- has at most one request under way. A write that met another revision begins anew from what is
  there now: of several nodes that write at once one succeeds, so all of them get on.

``advance`` compares what the record says with what it should say, and asks for the write that makes
up the difference. Nothing else writes. So a lost answer, a lost record or a room that two halves of
a cluster filled while they were apart need no rules of their own, but for this one: nobody who is
in is thrown out, so after a split a room may hold more than its capacity, and lets nobody in before
enough have gone.

    standing    record     under way    what advance does
    CLUSTERED   unknown    nothing      read it
    CLUSTERED   known      nothing      write what differs; else refuse whom there is no place for,
                                        once every node of the record has renewed its lease since
    CLUSTERED   any        a request    wait for the answer
    UNCERTAIN   any        any          wait; everybody who was seen stays
    LOCAL       forgotten  ignored      decide by who is here, show nobody else
"""

from dataclasses import dataclass, replace
from typing import Final

from pica_protocol.messages import Peer
from pica_server.cluster import messages
from pica_server.cluster.liveness import Liveness, Standing
from pica_server.cluster.media import Exchange
from pica_server.errors import ClusterMessageError

RETRY_S: Final = 0.25
"""After a request that failed."""
REWRITE_S: Final = 6 * 3600.0
"""A record that nobody changes is written anew after that: one that nobody writes for four times as
long is garbage of nodes that died, and the store clears it away."""
_MAX_FAREWELLS: Final = 64


@dataclass(frozen=True, slots=True)
class Read:
    """Fetch a record; ``Found`` or ``Failed`` is the answer."""

    key: str
    ticket: int


@dataclass(frozen=True, slots=True)
class Write:
    """Put a record if it still has this revision; the answer is any but ``Found``. An empty record
    is to be removed."""

    key: str
    ticket: int
    data: bytes
    revision: int


@dataclass(frozen=True, slots=True)
class Found:
    """What a read found; no bytes: there is no record."""

    data: bytes
    revision: int


@dataclass(frozen=True, slots=True)
class Written:
    """A write succeeded."""

    revision: int


@dataclass(frozen=True, slots=True)
class Conflict:
    """A write met another revision."""


@dataclass(frozen=True, slots=True)
class Failed:
    """Nobody knows what became of a request."""


Request = Read | Write
Answer = Found | Written | Conflict | Failed


@dataclass(frozen=True, slots=True)
class Admitted:
    """Somebody has a place."""

    peer: Peer


@dataclass(frozen=True, slots=True)
class Refused:
    """There is no place for somebody."""

    peer_id: str


@dataclass(frozen=True, slots=True)
class Arrived:
    """A peer of another node is in the room."""

    member: messages.Member


@dataclass(frozen=True, slots=True)
class Changed:
    """Something is different about a peer of another node."""

    before: messages.Member
    member: messages.Member


@dataclass(frozen=True, slots=True)
class Departed:
    """A peer of another node is not in the room any more."""

    peer_id: str
    reason: str


@dataclass(frozen=True, slots=True)
class Replaced:
    """A peer of this node has joined again on another one, or has been away in a full room."""

    peer_id: str


@dataclass(frozen=True, slots=True)
class Heard:
    """Another node has just written the record: it lives, whatever is known of its lease."""

    node: str


SharedRoomEvent = Admitted | Refused | Arrived | Changed | Departed | Replaced | Heard


class SharedRoom:
    """This node's view of one room.

    Attributes:
        exchange: What is exchanged with the other nodes, while there are any.
    """

    def __init__(self, name: str, capacity: int, me: messages.NodeId) -> None:
        self.name = name
        self.key = messages.room_key(name)
        self.revision = 0
        self.exchange: Exchange | None = None
        self._capacity = capacity
        self._me = me.name
        self._own: dict[str, messages.Member] = {}
        self._pending: dict[str, messages.Member] = {}
        self._since_s: dict[str, float] = {}  # when who is pending came
        self._shown: dict[str, messages.Member] = {}
        self._farewells: dict[str, str] = {}
        self._record: messages.Record | None = None
        self._last_words: dict[str, str] = {}
        self._learned_s = 0.0
        # Whether the record may hold peers of this node.
        self._may_be_listed = False
        # Under way: the request, and for a write the record it puts.
        self._request: Request | None = None
        self._written: messages.Record | None = None
        self._is_overtaken = False
        self._outgoing: Request | None = None
        self._last_ticket = 0
        self._retry_s = 0.0
        self._events: list[SharedRoomEvent] = []

    @property
    def is_over(self) -> bool:
        """Whether nobody here has to do with this room, and the record knows it."""
        return not (self._own or self._pending or self._may_be_listed or self._request is not None)

    @property
    def is_unsettled(self) -> bool:
        """Whether ``advance`` may have something to do without news of the record."""
        return bool(self._pending) or self._retry_s > 0.0

    @property
    def nodes(self) -> set[str]:
        """The other nodes with peers in the room."""
        return {member.node for member in self._shown.values()}

    def uses(self, stream: int) -> bool:
        """Say whether a peer of this node has this stream."""
        return any(
            track.stream == stream
            for members in (self._own, self._pending)
            for member in members.values()
            for track in member.peer.tracks
        )

    def join(self, peer: Peer, now: float) -> None:
        """Ask for a place; ``Admitted`` or ``Refused`` follows, unless ``leave`` does."""
        member = messages.Member(self._me, peer)
        for places in (self._own, self._pending):
            for peer_id in [p for p, m in places.items() if m.is_same_person(member)]:
                del places[peer_id]
                self._events.append(Replaced(peer_id))
        self._pending[peer.peer_id] = member
        self._since_s[peer.peer_id] = now

    def leave(self, peer_id: str, reason: str) -> None:
        """Give up a place, or the request for one."""
        self._pending.pop(peer_id, None)
        if self._own.pop(peer_id, None) is not None:
            if len(self._farewells) >= _MAX_FAREWELLS:
                self._farewells.pop(next(iter(self._farewells)))
            self._farewells[peer_id] = reason
        if not self._own:
            self._shown.clear()

    def update(self, peer: Peer, *, is_away: bool, muted: tuple[int, ...]) -> None:
        """Note what is different about a peer of this node."""
        member = self._own.get(peer.peer_id)
        if member is not None:
            member = replace(member, peer=peer, is_away=is_away, muted=muted)
            self._own[peer.peer_id] = member

    def receive_record(self, data: bytes, revision: int, now: float) -> None:
        """Take news of the record; what is older than what is known changes nothing.

        Raises:
            ClusterMessageError: It cannot be read.
        """
        if revision <= self.revision:
            return
        record = messages.decode_record(data)
        self._is_overtaken = True
        if data:
            if record.writer != self._me:
                self._events.append(Heard(record.writer))
            self._learn(record, revision, now)
        else:  # what to write over it is known only by reading: its trace is cleared away
            self._last_words = {}
            self.doubt()

    def doubt(self) -> None:
        """Note that news may have been lost: read the record again."""
        self._record = None
        self.revision = 0

    def receive_answer(self, ticket: int, answer: Answer, now: float) -> None:
        """Take the answer to a request; one to an older request changes nothing."""
        request, written = self._request, self._written
        if request is None or request.ticket != ticket:
            return
        self._request = self._written = None
        match answer:
            case Found(data=data, revision=revision):
                if self._is_overtaken:
                    return  # news came while it was under way
                try:
                    self._learn(messages.decode_record(data), revision, now)
                except ClusterMessageError:
                    self._retry_s = now + RETRY_S
            case Written(revision=revision):
                assert written is not None
                for peer_id in written.farewells:
                    self._farewells.pop(peer_id, None)
                if revision > self.revision and not self._is_overtaken:
                    self._learn(written, revision, now)
                    if _is_nothing(written):
                        self.doubt()
            case Conflict():
                if not self._is_overtaken:
                    self.doubt()
            case Failed():
                self.doubt()
                self._retry_s = now + RETRY_S

    def advance(self, standing: Standing, liveness: Liveness, now: float) -> None:
        """Do what the table says."""
        if standing is Standing.LOCAL:
            self._be_alone()
            self._forget_times()
            return
        if self._record is not None:
            self._show(self._record, liveness, now)
        if standing is Standing.UNCERTAIN or self._request is not None or now < self._retry_s:
            return
        self._retry_s = 0.0
        if self._record is None:
            if not self.is_over:
                self._begin(Read(self.key, self._ticket()))
            return
        wanted = self._wanted(self._record, liveness, now)
        if wanted is not None:
            data = b"" if _is_nothing(wanted) else messages.encode_record(wanted)
            if len(data) <= messages.MAX_RECORD_BYTES:
                self._may_be_listed = True
                self._begin(Write(self.key, self._ticket(), data, self.revision))
                self._written = wanted
                return
        self._refuse(liveness)

    def take_events(self) -> list[SharedRoomEvent]:
        """Take what has come out, in order."""
        events, self._events = self._events, []
        return events

    def take_request(self) -> Request | None:
        """Take the request that is to be made."""
        request, self._outgoing = self._outgoing, None
        return request

    def _ticket(self) -> int:
        self._last_ticket += 1
        return self._last_ticket

    def _begin(self, request: Request) -> None:
        self._request = self._outgoing = request
        self._is_overtaken = False

    def _learn(self, record: messages.Record, revision: int, now: float) -> None:
        """Know a record from now on, and let those in who are in it."""
        self._record, self.revision, self._learned_s = record, revision, now
        self._last_words = dict(record.farewells)
        mine = {m.peer.peer_id: m for m in record.members if m.node == self._me}
        self._may_be_listed = bool(mine)
        admitted = [mine[peer_id] for peer_id in self._pending if peer_id in mine]
        for member in admitted:
            del self._pending[member.peer.peer_id]
            self._own[member.peer.peer_id] = member
        if admitted:
            self._show_members([m for m in record.members if m.node != self._me])
            self._events += [Admitted(member.peer) for member in admitted]

    def _wanted(
        self, record: messages.Record, liveness: Liveness, now: float
    ) -> messages.Record | None:
        """Return the record as it should be, or None when this node need not write it."""
        here = self._me
        dead = {
            m.node for m in record.members if m.node != here and liveness.is_expired(m.node, now)
        }
        living = [m for m in record.members if m.node not in dead]
        others = [m for m in living if m.node != here]
        listed = {m.peer.peer_id for m in living if m.node == here}
        for peer_id, member in list(self._own.items()):
            if peer_id not in listed and any(map(member.is_same_person, others)):
                del self._own[peer_id]
                self._events.append(Replaced(peer_id))
        members = [
            m if m.node != here else self._own[m.peer.peer_id]
            for m in living
            if m.node != here or m.peer.peer_id in self._own
        ]
        members += [m for peer_id, m in self._own.items() if peer_id not in listed]
        for member in self._pending.values():
            others = [m for m in members if not m.is_same_person(member)]
            if len(others) >= self._capacity:
                others = self._without_one_away(others)
            if len(others) < self._capacity:
                members = [*others, member]
        is_same = [m for m in members if m.node == here] == [m for m in living if m.node == here]
        if is_same:
            # Others must see to what is left to do, unless this node is the first of all.
            is_old = now - self._learned_s >= REWRITE_S
            if not (dead or is_old) or (living and living[0].node != here):
                return None
        return messages.Record(tuple(members), dict(self._farewells), here)

    def _without_one_away(self, members: list[messages.Member]) -> list[messages.Member]:
        """Give up the place of one of this node who is away and has no identity, if there is one:
        else whoever comes and drops connections keeps a room full of nobody."""
        for member in members:
            if member.is_away and member.node == self._me and not member.peer.identity:
                del self._own[member.peer.peer_id]
                self._events.append(Replaced(member.peer.peer_id))
                return [other for other in members if other is not member]
        return members

    def _refuse(self, liveness: Liveness) -> None:
        """Refuse those for whom there is no place, once all who hold one have shown that they live:
        the peers of a node that has just died come back here, into their own places."""
        assert self._record is not None
        nodes = {m.node for m in self._record.members if m.node != self._me}
        for peer_id in list(self._pending):
            since_s = self._since_s[peer_id]
            if all(liveness.was_heard_since(node, since_s) for node in nodes):
                del self._pending[peer_id]
                self._events.append(Refused(peer_id))
        self._forget_times()

    def _forget_times(self) -> None:
        for peer_id in [p for p in self._since_s if p not in self._pending]:
            del self._since_s[peer_id]

    def _show(self, record: messages.Record, liveness: Liveness, now: float) -> None:
        """Tell the peers here who is in the room on other nodes."""
        if self._own:
            others = [m for m in record.members if m.node != self._me]
            self._show_members([m for m in others if not liveness.is_expired(m.node, now)])

    def _show_members(self, members: list[messages.Member]) -> None:
        shown = {member.peer.peer_id: member for member in members}
        if shown == self._shown:
            return
        for peer_id in [p for p in self._shown if p not in shown]:
            del self._shown[peer_id]
            self._events.append(Departed(peer_id, self._last_words.get(peer_id, "lost")))
        for peer_id, member in shown.items():
            before = self._shown.get(peer_id)
            self._shown[peer_id] = member
            if before is None:
                self._events.append(Arrived(member))
            elif before != member:
                self._events.append(Changed(before, member))

    def _be_alone(self) -> None:
        self.doubt()
        self._request = self._written = self._outgoing = None
        self._retry_s = 0.0
        self._last_words = {}
        self._show_members([])
        for peer_id, member in list(self._pending.items()):
            del self._pending[peer_id]
            if len(self._own) >= self._capacity:
                self._events.append(Refused(peer_id))
                continue
            self._own[peer_id] = member
            self._events.append(Admitted(member.peer))


def _is_nothing(record: messages.Record) -> bool:
    """Return True if a record need not be kept: nobody is in it."""
    return not record.members
