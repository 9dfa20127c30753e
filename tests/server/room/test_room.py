import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from pica_protocol.messages import SHARES, Join, Joined, Track
from pica_server.config import RelayConfig
from pica_server.room.hub import Hub
from pica_server.room.room import Connection, Room
from pica_server.tokens import Admission

pytestmark = pytest.mark.unit

FACE = Track(kind="face")
CAPACITY = 4
HUB = Hub(RelayConfig(max_connections=1_000_000))


def come(room: Room, num_tracks: int = 1) -> tuple[Connection, Joined]:
    member = HUB.connect(0.0)
    join = Join(room=room.name, name="name", tracks=(FACE,) * num_tracks)
    return member, room.join(member, join, Admission())


def test_a_stream_is_not_used_again_right_after_its_owner_left() -> None:
    room = Room("lobby", CAPACITY)
    room.leave(come(room)[0])
    assert come(room)[1].tracks[0].stream == 2


def test_streams_wrap_around_those_in_use() -> None:
    room = Room("lobby", CAPACITY)
    come(room)  # holds stream 1
    guest = HUB.connect(0.0)
    for num_tracks in (*[4] * 16_383, 2):  # 2 to 65,535
        room.join(guest, Join(room="lobby", name="Guest", tracks=(FACE,) * num_tracks), Admission())
        room.leave(guest)
    assert come(room)[1].tracks[0].stream == 2


def test_a_peer_that_wants_a_stream_again_is_told_apart_from_one_that_never_stopped() -> None:
    room = Room("lobby", CAPACITY)
    come(room)
    bob, _ = come(room)
    found = [room.subscribe(bob, 1, every) for every in (4, 0, 0, 2, 1)]
    assert found == [False, False, False, True, False]


class RoomMachine(RuleBasedStateMachine):
    """A room against a list of who came, with which streams, and a table of every wish."""

    def __init__(self) -> None:
        super().__init__()
        self.room = Room("lobby", CAPACITY)
        self.present: dict[Connection, list[int]] = {}
        self.wishes: dict[tuple[Connection, int], int] = {}

    @rule(num_tracks=st.integers(0, 4))
    def join(self, num_tracks: int) -> None:
        if len(self.present) == CAPACITY:
            assert self.room.is_full
            return
        member, joined = come(self.room, num_tracks)
        assert list(joined.peers) == [each.peer for each in self.present]
        taken = {stream for streams in self.present.values() for stream in streams}
        own = [track.stream for track in joined.tracks]
        assert len(own) == num_tracks
        assert not taken & set(own)
        self.present[member] = own

    @precondition(lambda self: self.present)
    @rule(data=st.data())
    def leave(self, data: st.DataObject) -> None:
        member = data.draw(st.sampled_from(list(self.present)))
        self.room.leave(member)
        gone = self.present.pop(member)
        self.wishes = {
            key: every
            for key, every in self.wishes.items()
            if key[0] is not member and key[1] not in gone
        }

    @precondition(lambda self: self.present)
    @rule(data=st.data(), stream=st.integers(1, 20), every=st.sampled_from(SHARES))
    def subscribe(self, data: st.DataObject, stream: int, every: int) -> None:
        member = data.draw(st.sampled_from(list(self.present)))
        self.room.subscribe(member, stream, every)
        if any(stream in streams for streams in self.present.values()):
            self.wishes[member, stream] = every

    @invariant()
    def frames_go_to_whom_the_reference_says(self) -> None:
        for publisher, streams in self.present.items():
            for stream in streams:
                for sequence in (0, 1, 2):
                    expected = []
                    for member in self.present:
                        every = self.wishes.get((member, stream), 1)
                        if member is not publisher and every and sequence % every == 0:
                            expected.append(member)
                    assert self.room.receivers(self.room.streams[stream], sequence) == expected

    @invariant()
    def everybody_present_is_listed_in_order(self) -> None:
        assert list(self.room.members.values()) == list(self.present)


RoomMachine.TestCase.settings = settings(max_examples=60, stateful_step_count=30)
TestRoomMachine = RoomMachine.TestCase
