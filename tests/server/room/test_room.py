import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from pica_protocol.messages import SHARES, Join, Joined, Track
from pica_server.room.room import Room
from pica_server.tokens import Admission

pytestmark = pytest.mark.unit

FACE = Track(kind="face")
CAPACITY = 4


def join(room: Room, peer_id: str, name: str, tracks: tuple[Track, ...]) -> Joined:
    return room.join(peer_id, Join(room=room.name, name=name, tracks=tracks), Admission())


def room_of(*names: str) -> Room:
    room = Room("lobby", capacity=8)
    for name in names:
        join(room, name, name, (FACE,))
    return room


def test_a_stream_is_not_used_again_right_after_its_owner_left() -> None:
    room = room_of("ada")
    room.leave("ada")
    assert join(room, "bob", "Bob", (FACE,)).tracks[0].stream == 2


def test_streams_wrap_around_those_in_use() -> None:
    room = room_of("ada")  # holds stream 1
    for _ in range(65_534):
        join(room, "guest", "Guest", (FACE,))
        room.leave("guest")
    assert join(room, "bob", "Bob", (FACE,)).tracks[0].stream == 2


def test_a_peer_that_wants_a_stream_again_is_told_apart_from_one_that_never_stopped() -> None:
    room = room_of("ada", "bob")
    found = [room.subscribe("bob", 1, every) for every in (4, 0, 0, 2, 1)]
    assert found == [False, False, False, True, False]


class RoomMachine(RuleBasedStateMachine):
    """A room against a list of who came, with which streams, and a table of every wish."""

    def __init__(self) -> None:
        super().__init__()
        self.room = Room("lobby", CAPACITY)
        self.present: dict[str, list[int]] = {}
        self.wishes: dict[tuple[str, int], int] = {}
        self.num_joins = 0

    @rule(num_tracks=st.integers(0, 4))
    def join(self, num_tracks: int) -> None:
        self.num_joins += 1
        peer_id = f"p{self.num_joins}"
        if len(self.present) == CAPACITY:
            assert self.room.is_full
            return
        joined = join(self.room, peer_id, "name", (FACE,) * num_tracks)
        assert [peer.peer_id for peer in joined.peers] == list(self.present)
        taken = {stream for streams in self.present.values() for stream in streams}
        own = [track.stream for track in joined.tracks]
        assert len(own) == num_tracks
        assert not taken & set(own)
        self.present[peer_id] = own

    @precondition(lambda self: self.present)
    @rule(data=st.data())
    def leave(self, data: st.DataObject) -> None:
        peer_id = data.draw(st.sampled_from(list(self.present)))
        self.room.leave(peer_id)
        gone = self.present.pop(peer_id)
        self.wishes = {
            key: every
            for key, every in self.wishes.items()
            if key[0] != peer_id and key[1] not in gone
        }

    @precondition(lambda self: self.present)
    @rule(data=st.data(), stream=st.integers(1, 20), every=st.sampled_from(SHARES))
    def subscribe(self, data: st.DataObject, stream: int, every: int) -> None:
        peer_id = data.draw(st.sampled_from(list(self.present)))
        self.room.subscribe(peer_id, stream, every)
        if any(stream in streams for streams in self.present.values()):
            self.wishes[peer_id, stream] = every

    @invariant()
    def frames_go_to_whom_the_reference_says(self) -> None:
        ids = {peer_id: peer_id for peer_id in self.present}
        for publisher, streams in self.present.items():
            for stream in streams:
                for sequence in (0, 1, 2):
                    expected = []
                    for peer_id in self.present:
                        every = self.wishes.get((peer_id, stream), 1)
                        if peer_id != publisher and every and sequence % every == 0:
                            expected.append(peer_id)
                    assert self.room.receivers(self.room.streams[stream], sequence, ids) == expected

    @invariant()
    def everybody_present_is_listed_in_order(self) -> None:
        assert [peer.peer_id for peer in self.room.peers] == list(self.present)


RoomMachine.TestCase.settings = settings(max_examples=60, stateful_step_count=30)
TestRoomMachine = RoomMachine.TestCase
