"""A room on several nodes: places, presence, and what happens when answers come late or never."""

from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pica_protocol.messages import Peer, Track
from pica_server.cluster.liveness import BEAT_S, FENCE_S, LEASE_S, Liveness, Standing
from pica_server.cluster.messages import NodeId, decode_record
from pica_server.cluster.room import (
    Admitted,
    Answer,
    Arrived,
    Conflict,
    Departed,
    Failed,
    Found,
    Heard,
    Read,
    Refused,
    Replaced,
    Request,
    SharedRoom,
    SharedRoomEvent,
    Write,
    Written,
)

pytestmark = pytest.mark.unit


class Store:
    """A key-value store of one key, with revisions, as JetStream keeps one."""

    def __init__(self) -> None:
        self.data = b""
        self.revision = 0
        self.last = 0

    def do(self, request: Request) -> Answer:
        if isinstance(request, Read):
            return Found(self.data, self.revision)
        if request.revision != self.revision:
            return Conflict()
        self.last += 1
        self.data = request.data
        # What is removed leaves no trace behind that a write would have to name.
        self.revision = self.last if request.data else 0
        return Written(self.last)

    @property
    def peers(self) -> list[str]:
        return [member.peer.peer_id for member in decode_record(self.data).members]


@dataclass
class Node:
    """One node's view, and what came of it."""

    name: str
    room: SharedRoom
    liveness: Liveness
    standing: Standing = Standing.CLUSTERED
    here: set[str] = field(default_factory=set)
    others: set[str] = field(default_factory=set)
    refused: set[str] = field(default_factory=set)
    farewells: list[tuple[str, str]] = field(default_factory=list)

    def advance(self, now: float) -> Request | None:
        self.room.advance(self.standing, self.liveness, now)
        for event in self.room.take_events():
            self.note(event, now)
        return self.room.take_request()

    def note(self, event: SharedRoomEvent, now: float) -> None:
        match event:
            case Heard(node=name):
                self.liveness.receive_beat(name, now)
            case Admitted(peer=peer):
                self.here.add(peer.peer_id)
            case Refused(peer_id=peer_id):
                self.refused.add(peer_id)
            case Replaced(peer_id=peer_id):
                self.here.discard(peer_id)
            case Arrived(member=member):
                assert member.peer.peer_id not in self.others
                self.others.add(member.peer.peer_id)
            case Departed(peer_id=peer_id, reason=reason):
                self.others.remove(peer_id)
                self.farewells.append((peer_id, reason))

    def hear(self, *nodes: "Node", now: float = 0.0) -> None:
        for each in nodes:
            self.liveness.receive_beat(each.name, now)

    def leave(self, peer_id: str, reason: str = "left") -> None:
        self.here.discard(peer_id)
        self.room.leave(peer_id, reason)
        if not self.here:
            self.others.clear()


def node(slot: int, capacity: int = 3) -> Node:
    me = NodeId(slot, "a1")
    return Node(me.name, SharedRoom("lobby", capacity, me), Liveness(0.0))


def somebody(peer_id: str, identity: str = "") -> Peer:
    tracks = (Track(kind="face", stream=7),)
    return Peer(peer_id=peer_id, name="Ada", tracks=tracks, identity=identity)


def settle(store: Store, *nodes: Node, now: float = 0.0) -> None:
    """Let everybody do what they want until nobody wants anything; all news arrives, and all these
    are heard to live."""
    for each in nodes:
        each.hear(*(other for other in nodes if other is not each), now=now)
    for _ in range(100):
        is_quiet = True
        for each in nodes:
            request = each.advance(now)
            if request is None:
                continue
            is_quiet = False
            answer = store.do(request)
            if isinstance(answer, Written):
                for other in nodes:
                    other.room.receive_record(store.data, store.last, now)
            each.room.receive_answer(request.ticket, answer, now)
        if is_quiet:
            return
    raise AssertionError("they never come to an end")


def test_peers_of_two_nodes_see_each_other_come_and_go_with_the_reason() -> None:
    store, first, second = Store(), node(1), node(2)
    first.room.join(somebody("ada"), 0.0)
    second.room.join(somebody("bob"), 0.0)
    settle(store, first, second)
    assert (first.here, first.others) == ({"ada"}, {"bob"})
    assert (second.here, second.others) == ({"bob"}, {"ada"})
    first.leave("ada", "left")
    settle(store, first, second)
    assert second.farewells == [("ada", "left")]
    assert store.peers == ["bob"]


def test_of_two_nodes_that_take_the_last_place_at_once_one_gets_it() -> None:
    store, first, second = Store(), node(1, capacity=1), node(2, capacity=1)
    first.room.join(somebody("ada"), 0.0)
    second.room.join(somebody("bob"), 0.0)
    reads = [each.advance(0.0) for each in (first, second)]
    for each, read in zip((first, second), reads, strict=True):
        assert read is not None
        each.room.receive_answer(read.ticket, store.do(read), 0.0)
    writes = [each.advance(0.0) for each in (first, second)]
    for each, write in zip((first, second), writes, strict=True):
        assert isinstance(write, Write)
        each.room.receive_answer(write.ticket, store.do(write), 0.0)
    settle(store, first, second)
    assert first.here == {"ada"}
    assert second.refused == {"bob"}
    assert store.peers == ["ada"]


def test_a_node_that_empties_its_part_of_a_room_takes_nobody_else_out_of_it() -> None:
    store, first, second = Store(), node(1), node(2)
    first.room.join(somebody("ada"), 0.0)
    second.room.join(somebody("bob"), 0.0)
    settle(store, first, second)
    first.leave("ada")
    settle(store, first, second)
    assert first.room.is_over
    assert store.peers == ["bob"]
    second.leave("bob")
    settle(store, first, second)
    assert store.data == b""
    assert second.room.is_over


def test_who_joins_elsewhere_under_the_same_identity_replaces_themselves() -> None:
    store, first, second = Store(), node(1, capacity=1), node(2, capacity=1)
    first.room.join(somebody("old", "ada"), 0.0)
    settle(store, first, second)
    second.room.join(somebody("new", "ada"), 0.0)
    settle(store, first, second)
    assert (first.here, second.here) == (set(), {"new"})
    assert store.peers == ["new"]


def test_the_peers_of_a_dead_node_are_gone_when_its_lease_is_over() -> None:
    store, first, second = Store(), node(1, capacity=2), node(2, capacity=2)
    first.room.join(somebody("ada"), 0.0)
    second.room.join(somebody("bob"), 0.0)
    settle(store, first, second)
    first.liveness.receive_beat("2-a1", 1.0)
    for beat in range(8):
        first.liveness.receive_renewed(beat * BEAT_S, beat * BEAT_S)
    settle(store, first, now=1.0 + LEASE_S)
    assert first.others == {"bob"}
    settle(store, first, now=1.0 + LEASE_S + 0.01)
    assert first.farewells == [("bob", "lost")]
    assert store.peers == ["ada"]


def test_a_join_waits_while_a_node_that_may_be_dead_holds_the_last_place() -> None:
    store, first, second = Store(), node(1, capacity=2), node(2, capacity=2)
    first.room.join(somebody("ada"), 0.0)
    second.room.join(somebody("bob"), 0.0)
    settle(store, first, second)
    first.room.join(somebody("bob-again"), 0.5)
    settle(store, first, now=2.0)
    assert first.refused == set()
    settle(store, first, now=LEASE_S + 0.01)
    assert first.here == {"ada", "bob-again"}


def test_a_join_that_finds_the_room_full_of_the_living_is_refused_at_once() -> None:
    store, first, second = Store(), node(1, capacity=1), node(2, capacity=1)
    first.room.join(somebody("ada"), 0.0)
    settle(store, first, second)
    second.room.join(somebody("bob"), 0.0)
    settle(store, first, second)
    assert second.refused == {"bob"}


def test_alone_a_node_decides_by_who_is_here_and_shows_nobody_else() -> None:
    store, first, second = Store(), node(1, capacity=2), node(2, capacity=2)
    first.room.join(somebody("ada"), 0.0)
    second.room.join(somebody("bob"), 0.0)
    settle(store, first, second)
    first.standing = Standing.LOCAL
    first.room.join(somebody("cleo"), 0.0)
    first.room.join(somebody("dan"), 0.0)
    assert first.advance(9.0) is None
    assert (first.here, first.others) == ({"ada", "cleo"}, set())
    assert first.refused == {"dan"}


def test_when_two_halves_meet_again_everybody_stays_and_nobody_comes_before_enough_have_gone() -> (
    None
):
    store, first, second = Store(), node(1, capacity=2), node(2, capacity=2)
    first.room.join(somebody("ada"), 0.0)
    second.room.join(somebody("bob"), 0.0)
    settle(store, first, second)
    first.standing = Standing.LOCAL
    first.room.join(somebody("cleo"), 0.0)
    first.advance(9.0)
    second.liveness.forget("1-a1")
    second.room.join(somebody("dan"), 0.0)
    settle(store, second)
    assert store.peers == ["bob", "dan"]
    first.standing = Standing.CLUSTERED
    settle(store, first, second, now=0.0)
    assert first.here | first.others == second.here | second.others == {"ada", "bob", "cleo", "dan"}
    for leaver in ("ada", "cleo"):
        second.room.join(somebody("eve"), 0.0)
        settle(store, first, second)
        assert second.refused == {"eve"}
        first.leave(leaver)
        settle(store, first, second)
    second.refused.clear()
    second.leave("dan")
    second.room.join(somebody("fay"), 0.0)
    settle(store, first, second)
    assert second.here == {"bob", "fay"}


def test_a_write_of_which_nobody_heard_again_is_not_made_twice() -> None:
    store, first = Store(), node(1)
    first.room.join(somebody("ada"), 0.0)
    read = first.advance(0.0)
    assert read is not None
    first.room.receive_answer(read.ticket, store.do(read), 0.0)
    write = first.advance(0.0)
    assert isinstance(write, Write)
    store.do(write)
    first.room.receive_answer(write.ticket, Failed(), 1.0)
    assert first.advance(1.0) is None, "it waits a moment"
    settle(store, first, now=1.5)
    assert first.here == {"ada"}
    assert store.revision == 1


def test_who_hangs_up_while_the_answer_is_under_way_leaves_nothing_behind() -> None:
    store, first = Store(), node(1)
    first.room.join(somebody("ada"), 0.0)
    read = first.advance(0.0)
    assert read is not None
    first.room.receive_answer(read.ticket, store.do(read), 0.0)
    write = first.advance(0.0)
    assert write is not None
    first.leave("ada")
    first.room.receive_answer(write.ticket, store.do(write), 0.0)
    assert not first.room.is_over
    settle(store, first)
    assert first.here == set()
    assert store.data == b""
    assert first.room.is_over


def test_a_node_that_lost_its_standing_remembers_what_it_may_have_left_in_the_record() -> None:
    store, first = Store(), node(1)
    first.room.join(somebody("ada"), 0.0)
    settle(store, first)
    first.standing = Standing.LOCAL
    first.advance(9.0)
    first.leave("ada")
    first.advance(9.0)
    assert not first.room.is_over
    first.standing = Standing.CLUSTERED
    settle(store, first, now=0.0)
    assert store.data == b""
    assert first.room.is_over


def test_a_node_stops_counting_on_the_cluster_before_the_others_give_its_places_away() -> None:
    mine, theirs = Liveness(0.0), Liveness(0.0)
    theirs.receive_beat("1-a1", 0.0)
    assert mine.standing(FENCE_S) is Standing.LOCAL
    assert not theirs.is_expired("1-a1", FENCE_S)
    assert theirs.is_expired("1-a1", LEASE_S + 0.01)


def test_who_comes_back_has_no_opinion_on_others_before_it_has_listened_for_a_lease() -> None:
    liveness = Liveness(0.0)
    liveness.receive_beat("2-a1", 0.0)
    liveness.receive_renewed(100.0, 100.1)
    assert not liveness.is_expired("2-a1", 100.1 + LEASE_S)
    assert liveness.is_expired("2-a1", 100.2 + LEASE_S)


STEPS = st.lists(
    st.tuples(st.sampled_from("jjlaaaaddf"), st.integers(0, 2), st.integers(0, 5)), max_size=120
)


@settings(max_examples=300, deadline=None)
@given(steps=STEPS, capacity=st.integers(1, 4))
def test_whatever_the_order_of_answers_no_room_takes_more_than_it_may_and_all_agree_in_the_end(
    steps: list[tuple[str, int, int]], capacity: int
) -> None:
    store = Store()
    nodes = [node(slot, capacity) for slot in range(3)]
    news: list[tuple[int, bytes, int]] = []  # receiver, data, revision; in order for each receiver
    answers: list[tuple[int, int, Answer]] = []
    num_peers = 0
    for what, where, which in steps:
        here = nodes[where]
        if what == "j":
            num_peers += 1
            identity = ["", "", "", "x", "y", "z"][which]
            here.room.join(somebody(f"p{num_peers}", identity), 0.0)
        elif what == "l" and here.here:
            here.leave(sorted(here.here)[which % len(here.here)])
        elif what == "a":
            request = here.advance(0.0)
            if request is not None:
                answer = store.do(request)
                answers.append((where, request.ticket, answer))
                if isinstance(answer, Written):
                    news += [(to, store.data, store.last) for to in range(3)]
        elif what == "d" and answers:
            to, ticket, answer = answers.pop(which % len(answers))
            nodes[to].room.receive_answer(ticket, answer, 0.0)
        elif what == "f" and news:
            to = news[which % len(news)][0]
            index = next(i for i, item in enumerate(news) if item[0] == to)
            _, data, revision = news.pop(index)
            nodes[to].room.receive_record(data, revision, 0.0)
        assert len(store.peers) <= capacity
    for to, data, revision in news:
        nodes[to].room.receive_record(data, revision, 0.0)
    for to, ticket, answer in answers:
        nodes[to].room.receive_answer(ticket, answer, 0.0)
    settle(store, *nodes)
    for each in nodes:
        assert each.room.is_over == (not each.here)
        if each.here:
            assert sorted(each.here | each.others) == sorted(store.peers)
    assert len(store.peers) == sum(len(each.here) for each in nodes)
