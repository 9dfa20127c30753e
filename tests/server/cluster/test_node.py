"""Whole hubs on several nodes, with literal times: the bytes between them are carried by hand."""

from collections.abc import Callable, Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.members import FACE, VOICE, Member, counting_secrets
from pica_protocol.errors import CloseCode
from pica_protocol.frames import Frame
from pica_protocol.messages import (
    BarIdentity,
    KeyframeRequest,
    PeerAway,
    PeerBack,
    PeerJoined,
    PeerLeft,
    PeerUpdated,
    StreamMuted,
    Track,
    UpdateMetadata,
    Want,
    Whisper,
)
from pica_server.auth.tokens import Admission
from pica_server.cluster.liveness import BEAT_S, LEASE_S, Standing
from pica_server.cluster.messages import NodeId
from pica_server.cluster.node import ClusterNode, Tell, Unwatch, Watch
from pica_server.cluster.room import Conflict, Found, Read, Written
from pica_server.config.relay import RelayConfig
from pica_server.room.hub import Hub

pytestmark = pytest.mark.unit


class Nodes:
    """Hubs that share their rooms, and what lies between them: a store and a way to each other.

    Attributes:
        hubs: The hubs.
        nodes: Their places in the cluster.
        loses: Says of each message from node to node whether it is lost.
    """

    def __init__(self, count: int, *, capacity: int = 16, with_identities: bool = False) -> None:
        config = RelayConfig(room_capacity=capacity)
        self.loses: Callable[[], bool] = lambda: False
        self.hubs = []
        self.nodes = []
        self._records: dict[str, tuple[bytes, int]] = {}
        self._revision = 0
        self._watching: list[set[str]] = [set() for _ in range(count)]
        for slot in range(count):
            admit = (lambda join: Admission(identity=join.name)) if with_identities else None
            hub = Hub(config, admit, new_secret=counting_secrets())
            node = ClusterNode(hub, NodeId(slot, "a1"), capacity, 0.0)
            hub.meet(node, f"n{slot}-")
            self.hubs.append(hub)
            self.nodes.append(node)

    def beat(self, now: float, *slots: int) -> None:
        """Let these nodes renew their leases."""
        for slot in slots:
            self.nodes[slot].receive_renewed(now, now)
            for other in self.nodes:
                if other.standing is Standing.CLUSTERED:
                    other.receive_lease(str(slot), self.nodes[slot].me.name.encode(), now)

    def live(self, start: float, end: float, *slots: int) -> None:
        """Let time pass for these nodes alone."""
        now = start
        while now <= end:
            self.beat(now, *slots)
            for slot in slots:
                self.nodes[slot].handle_timer(now)
            self.pump(now, *slots)
            now += BEAT_S / 2

    def pump(self, now: float, *slots: int) -> None:
        """Carry everything there is, from all nodes or from these, until there is nothing more."""
        for _ in range(200):
            if not any([self.carry(slot, now) for slot in slots or range(len(self.nodes))]):
                return
        raise AssertionError("they never come to an end")

    def join(
        self,
        slot: int,
        name: str,
        now: float = 0.0,
        *,
        resumable: bool = False,
        tracks: tuple[Track, ...] = (FACE,),
    ) -> Member:
        """Let somebody join, and tell everybody."""
        member = Member(self.hubs[slot], name, now=now, resumable=resumable, tracks=tracks)
        self.pump(now)
        member.heard += member.listen(now)
        return member

    def carry(self, slot: int, now: float) -> bool:
        """Carry what there is from one node, once; return whether there was anything."""
        node = self.nodes[slot]
        node.step(now)
        is_busy = False
        for command in node.take_commands():
            is_busy = True
            match command:
                case Watch(key=key):
                    self._watching[slot].add(key)
                case Unwatch(key=key):
                    self._watching[slot].discard(key)
                case Tell(slot=to, data=data):
                    if self.loses():  # the client library says so
                        self.nodes[to].receive_loss_of_all()
                    else:
                        self.nodes[to].receive_node_message(data, now)
                case Read(key=key, ticket=ticket):
                    node.receive_answer(key, ticket, Found(*self._records.get(key, (b"", 0))), now)
                case _:
                    self._write(slot, command.key, command.ticket, command, now)
        for to, key, data in node.exchanges.take_media(now):
            is_busy = True
            if not self.loses():
                self.nodes[to].receive_media(key, data, now)
        return is_busy

    def _write(self, slot: int, key: str, ticket: int, command: object, now: float) -> None:
        revision, data = command.revision, command.data  # type: ignore[attr-defined]
        if revision != self._records.get(key, (b"", 0))[1]:
            self.nodes[slot].receive_answer(key, ticket, Conflict(), now)
            return
        self._revision += 1
        if data:
            self._records[key] = (data, self._revision)
        else:
            self._records.pop(key, None)
        for watching, other in zip(self._watching, self.nodes, strict=True):
            if key in watching:
                other.receive_record(key, data, self._revision, now)
        self.nodes[slot].receive_answer(key, ticket, Written(self._revision), now)


def told(member: Member, kind: type, now: float = 0.0) -> list[object]:
    return [event for event in member.listen(now) if isinstance(event, kind)]


def test_a_peer_elsewhere_comes_speaks_whispers_is_asked_and_goes() -> None:
    nodes = Nodes(2)
    ada = nodes.join(0, "Ada")
    bob = nodes.join(1, "Bob")
    assert [event.peer.name for event in told(ada, PeerJoined)] == ["Bob"]
    assert [peer.name for peer in bob.session.peers.values()] == ["Ada"]
    ada.send_frame(b"hello", 0.0)
    nodes.pump(0.0)
    assert [frame.payload for frame in told(bob, Frame)] == [b"hello"]
    bob.session.tell(Whisper(peer_id=ada.peer_id, data=b"psst"))
    bob.session.tell(KeyframeRequest(stream=ada.stream))
    bob.speak(0.0)
    nodes.pump(0.0)
    heard = ada.listen(0.0)
    assert heard == [Whisper(peer_id=bob.peer_id, data=b"psst"), KeyframeRequest(stream=ada.stream)]
    bob.session.leave(0.0)
    bob.speak(0.0)
    nodes.pump(0.0)
    assert told(ada, PeerLeft) == [PeerLeft(peer_id=bob.peer_id, reason="left")]
    assert nodes.hubs[1].num_rooms == nodes.nodes[1].num_rooms == 0


@pytest.mark.parametrize(("leaver", "num_requests"), [("Ada", 1), ("Bob", 2)])
def test_who_leaves_as_the_store_answers_a_join_leaves_a_whole_room_behind(
    leaver: str, num_requests: int
) -> None:
    nodes = Nodes(2)
    xen = nodes.join(1, "Xen")
    members = [nodes.join(0, "Ada")] if leaver == "Ada" else []
    members.append(Member(nodes.hubs[0], "Bob"))
    for _ in range(num_requests):  # a node without peers in the room reads the record first
        nodes.carry(0, 0.0)
    gone = members.pop(0)
    gone.session.leave(0.0)
    gone.speak(0.0)
    nodes.pump(0.0)
    members.append(nodes.join(0, "Cyd"))
    for member in members:
        member.listen(0.0)
        assert "Xen" in [peer.name for peer in member.session.peers.values()]
    xen.session.leave(0.0)
    xen.speak(0.0)
    nodes.pump(0.0)
    members.append(nodes.join(0, "Dan"))
    for member in members:
        member.listen(0.0)
        assert len(member.session.peers) == len(members) - 1


def test_voices_cross_whole_and_in_order_before_faces_and_none_that_is_too_old() -> None:
    nodes = Nodes(2)
    both = {"tracks": (FACE, VOICE)}
    ada, bob = nodes.join(0, "Ada", **both), nodes.join(1, "Bob", **both)
    cleo = nodes.join(1, "Cleo")
    nodes.pump(0.0)
    for each in (ada, bob, cleo):
        each.listen(0.0)
    cleo.session.tell(Want(stream=ada.session.tracks[1].stream, layer=None))
    cleo.speak(0.0)
    nodes.pump(0.0)

    def packets(member: Member, now: float) -> list[bytes]:
        return [each.payload for each in member.listen(now) if isinstance(each, Frame)]

    for number in range(5):  # they talk at the same time, and a face waits for a voice
        now = 1.0 + 0.04 * number
        ada.send_frame(b"face", now + 0.001)
        ada.send_frame(b"ada %d" % number, now + 0.002, track=1)
        bob.send_frame(b"bob %d" % number, now + 0.002, track=1)
    nodes.pump(1.2)
    assert packets(bob, 1.2) == [*(b"ada %d" % number for number in range(5)), b"face"]
    assert packets(ada, 1.2) == [b"bob %d" % number for number in range(5)]
    assert packets(cleo, 1.2) == [*(b"bob %d" % number for number in range(5)), b"face"]

    for number in range(10):  # nobody carries anything between the nodes for a while
        ada.send_frame(b"late %d" % number, 2.0 + 0.04 * number, track=1)
    nodes.pump(2.41)
    assert packets(bob, 2.41) == [b"late %d" % number for number in range(6, 10)]
    assert packets(cleo, 2.41) == []


def test_the_newer_of_two_of_the_same_identity_stays_on_whichever_node() -> None:
    nodes = Nodes(2, with_identities=True)
    first = nodes.join(0, "Ada")
    second = nodes.join(1, "Ada")
    assert first.closed_code == CloseCode.REPLACED
    assert second.closed_code is None
    nodes.join(0, "Ada")
    assert second.closed_code == CloseCode.REPLACED


def test_what_a_peer_says_of_itself_is_known_on_all_nodes_then_and_later() -> None:
    nodes = Nodes(2)
    ada = nodes.join(0, "Ada")
    bob = nodes.join(1, "Bob")
    ada.session.tell(UpdateMetadata(metadata=(("hand", "up"),)))
    ada.speak(0.0)
    nodes.pump(0.0)
    assert told(bob, PeerUpdated) == [PeerUpdated(peer_id=ada.peer_id, metadata=(("hand", "up"),))]
    cleo = nodes.join(1, "Cleo")
    assert cleo.session.peers[ada.peer_id].metadata == (("hand", "up"),)


def test_a_peer_that_is_away_and_comes_back_is_so_on_all_nodes() -> None:
    nodes = Nodes(2)
    ada = nodes.join(0, "Ada", resumable=True)
    bob = nodes.join(1, "Bob")
    ticket = ada.lose_connection(1.0)
    nodes.pump(1.0)
    assert told(bob, PeerAway) == [PeerAway(peer_id=ada.peer_id)]
    cleo = nodes.join(1, "Cleo", 1.0)
    assert PeerAway(peer_id=ada.peer_id) in cleo.heard
    back = Member(nodes.hubs[0], "Ada", now=1.5, resumable=True, ticket=ticket)
    nodes.pump(1.5)
    assert back.peer_id == ada.peer_id
    assert told(bob, PeerBack) == [PeerBack(peer_id=ada.peer_id)]
    back.send_frame(b"again", 1.6)
    nodes.pump(1.6)
    assert [frame.payload for frame in told(bob, Frame)] == [b"again"]


def test_an_admin_mutes_and_bars_from_any_node() -> None:
    nodes = Nodes(2, with_identities=True)
    ada, bob, cleo = nodes.join(0, "Ada"), nodes.join(1, "Bob"), nodes.join(1, "Cleo")
    first, second = (hub.room("lobby") for hub in nodes.hubs)
    assert first is not None
    assert second is not None
    nodes.hubs[1].moderation.mute(second, ada.stream, is_muted=True, now=0.0)
    nodes.pump(0.0)
    for each in (ada, bob):
        assert told(each, StreamMuted) == [StreamMuted(stream=ada.stream, is_muted=True)]
    ada.send_frame(b"x", 0.0)
    nodes.pump(0.0)
    assert told(bob, Frame) == []
    nodes.hubs[1].moderation.mute(second, ada.stream, is_muted=False, now=0.0)
    nodes.pump(0.0)
    for each in (ada, bob):
        assert told(each, StreamMuted) == [StreamMuted(stream=ada.stream, is_muted=False)]
    ada.send_frame(b"y", 0.0)
    nodes.pump(0.0)
    assert [frame.payload for frame in told(bob, Frame)] == [b"y"]
    ada.connection.is_admin = True
    ada.session.tell(BarIdentity(identity="Cleo", is_barred=True))
    ada.speak(0.0)
    nodes.pump(0.0)
    assert cleo.closed_code == CloseCode.REMOVED
    for slot in (0, 1):
        assert nodes.join(slot, "Cleo").closed_code == CloseCode.FORBIDDEN


def test_in_a_full_room_a_newcomer_gets_the_place_of_who_is_away_on_its_node() -> None:
    nodes = Nodes(2, capacity=2)
    ada, bob = nodes.join(0, "Ada", resumable=True), nodes.join(1, "Bob", resumable=True)
    ada.lose_connection(now=1.0)
    nodes.pump(1.0)
    assert nodes.join(0, "Cyd", 2.0).closed_code is None
    news = [type(each) for each in bob.listen(2.0)]
    assert news[-2:] == [PeerLeft, PeerJoined]


def test_a_node_that_falls_silent_is_gone_after_its_lease_and_back_when_it_speaks() -> None:
    nodes = Nodes(2)
    ada, bob = nodes.join(0, "Ada"), nodes.join(1, "Bob")
    nodes.beat(0.0, 0, 1)
    nodes.live(0.0, LEASE_S - 0.1, 0)
    assert told(ada, PeerLeft) == []
    assert nodes.nodes[0].num_nodes == 2
    nodes.live(LEASE_S, LEASE_S + 1.0, 0)
    assert told(ada, PeerLeft) == [PeerLeft(peer_id=bob.peer_id, reason="lost")]
    assert nodes.nodes[0].num_nodes == 1
    nodes.nodes[1].handle_timer(LEASE_S + 1.0)
    nodes.pump(LEASE_S + 1.0)
    assert nodes.nodes[1].trouble == "cluster lost, rooms are local"
    assert told(bob, PeerLeft) == [PeerLeft(peer_id=ada.peer_id, reason="lost")]
    nodes.live(LEASE_S + 2.0, LEASE_S + 3.0, 0, 1)
    assert [event.peer.name for event in told(ada, PeerJoined)] == ["Bob"]
    assert [event.peer.name for event in told(bob, PeerJoined)] == ["Ada"]
    assert nodes.nodes[1].trouble == ""


def test_who_lost_the_slot_sends_everybody_away_to_come_again() -> None:
    nodes = Nodes(2)
    ada, bob = nodes.join(0, "Ada"), nodes.join(1, "Bob")
    nodes.nodes[0].restart(NodeId(5, "b2"), 1.0)
    assert ada.closed_code == CloseCode.GOING_AWAY
    assert bob.closed_code is None
    again = Member(nodes.hubs[0], "Ada", now=1.0)
    nodes.nodes[0].step(1.0)
    assert again.closed_code is None
    assert nodes.nodes[0].me.slot == 5


def test_no_record_is_read_after_a_reconnection_before_the_lease_is_confirmed() -> None:
    nodes = Nodes(1)
    nodes.beat(0.0, 0)
    nodes.join(0, "ada")
    node = nodes.nodes[0]
    node.receive_reconnected(0.1)
    node.step(0.1)
    assert node.standing is Standing.UNCERTAIN
    assert node.take_commands() == []
    node.receive_renewed(0.2, 0.2)
    node.step(0.2)
    assert [type(command) for command in node.take_commands()] == [Read]


def test_what_no_node_sends_is_counted_and_costs_nothing() -> None:
    nodes = Nodes(2)
    ada = nodes.join(0, "Ada")
    key = next(command for command in [*nodes._records])
    node = nodes.nodes[0]
    node.receive_node_message(b"\xff", 0.0)
    node.receive_record(key, b"\xff", 10**6, 0.0)
    nodes.join(1, "Bob")
    node.receive_media(key, b"\xff", 0.0)
    nodes.pump(0.0)
    assert nodes.hubs[0].stats.cluster["unreadable"] == 3
    assert [peer.name for peer in ada.session.peers.values()] or told(ada, PeerJoined)
    assert ada.closed_code is None


@settings(max_examples=60, deadline=None)
@given(losses=st.lists(st.booleans(), min_size=40, max_size=40))
def test_whatever_is_lost_between_nodes_nobody_gets_what_they_cannot_decode_and_all_heals(
    losses: list[bool],
) -> None:
    nodes = Nodes(3)
    members = [nodes.join(slot, name) for slot, name in enumerate(("Ada", "Bob", "Cleo"))]
    flags: Iterator[bool] = iter(losses)
    nodes.loses = lambda: next(flags, False)
    last: dict[tuple[int, int], int] = {}
    received = [0, 0, 0]
    now = 0.0
    for turn in range(120):
        now += 0.04
        if turn % 18 == 0:
            nodes.beat(now, 0, 1, 2)
        for member in members:
            member.send_frame(b"%d" % turn, now, is_keyframe=turn == 0)
        for node in nodes.nodes:
            node.handle_timer(now)
        nodes.pump(now)
        for index, member in enumerate(members):
            for event in member.listen(now):
                if isinstance(event, KeyframeRequest):
                    member.send_frame(b"key", now)
                if not isinstance(event, Frame):
                    continue
                place = (index, event.stream)
                if not event.is_keyframe:
                    assert last[place] == event.sequence - 1
                last[place] = event.sequence
                received[index] += 1
    assert next(flags, None) is None or not any(flags)
    for index, member in enumerate(members):
        for other in members:
            if other is not member:
                sent = other.session._next_sequence[0] - 1
                assert last[index, other.stream] >= sent - 1
