"""Streams that flow: receivers who keep up get every frame, without its queue."""

from collections import Counter

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from pica_protocol.frames import FLAG_KEYFRAME, Frame, decode_media, encode_frame
from pica_server.room.outbox import MAX_FLOWING_BYTES, MAX_FLOWING_FRAMES, ArrivedFrame, Outbox

pytestmark = pytest.mark.unit


def arrived(
    stream: int, sequence: int, layer: int = 0, *, is_key: bool = False, num_bytes: int = 6
) -> ArrivedFrame:
    frame = Frame(
        stream=stream,
        sequence=sequence,
        captured_us=0,
        payload=bytes(num_bytes),
        layer=layer,
        is_keyframe=is_key,
    )
    flags = FLAG_KEYFRAME if is_key else 0
    return ArrivedFrame(stream, encode_frame(frame), layer, flags, sequence / 1e3)


def flowing(*streams: int) -> Outbox:
    """An outbox to which these streams flow, of each of which it has got a keyframe."""
    outbox = Outbox(1000, Counter())
    for stream in streams:
        outbox.put(arrived(stream, 0, is_key=True))
        outbox.take()
    return outbox


def taken(outbox: Outbox) -> list[tuple[int, int]]:
    """Stream and sequence of all that waits."""
    frames = []
    while (message := outbox.take()) is not None:
        frames += decode_media(message.data)
    return [(frame.stream, frame.sequence) for frame in frames]


def test_receivers_of_one_frame_are_given_the_very_same_message() -> None:
    first, second = flowing(1), flowing(1)
    frame = arrived(1, 1)
    for outbox in (first, second):
        outbox.put(frame)
    assert first.take() is second.take() is frame.alone


def test_frames_of_several_streams_leave_in_one_message_in_order() -> None:
    outbox = flowing(1, 2)
    for stream, sequence in ((2, 1), (1, 1), (2, 2)):
        outbox.put(arrived(stream, sequence))
    message = outbox.take()
    assert message is not None
    assert message.received_s == (0.001, 0.001, 0.002)
    assert [frame.stream for frame in decode_media(message.data)] == [2, 1, 2]
    assert not outbox.is_waiting


def test_a_keyframe_that_flows_replaces_nothing() -> None:
    outbox = flowing(1)
    outbox.put(arrived(1, 1))
    outbox.put(arrived(1, 2, is_key=True))
    assert taken(outbox) == [(1, 1), (1, 2)]


@pytest.mark.parametrize(
    ("num_bytes", "most"), [(6, MAX_FLOWING_FRAMES), (1184, MAX_FLOWING_BYTES // 1200)]
)
def test_a_reader_that_does_not_take_is_thinned_when_the_list_is_full(
    num_bytes: int, most: int
) -> None:
    outbox = flowing(1)
    for sequence in range(1, most + 1):
        outbox.put(arrived(1, sequence, layer=1, num_bytes=num_bytes))
    assert outbox.waiting_frames == most
    outbox.put(arrived(1, most + 1, layer=1, num_bytes=num_bytes))
    assert outbox.waiting_frames <= 3


def test_a_subscription_stops_the_flow_of_its_stream_alone() -> None:
    outbox = flowing(1, 2)
    for stream in (1, 2):
        outbox.put(arrived(stream, 1, layer=2))
    assert outbox.want(1, 1) == 1
    assert taken(outbox) == [(2, 1)]


class Twins(RuleBasedStateMachine):
    """Receivers of one room: two to which streams may flow, and one to which none does but that is
    told and asked the same as the first. It misses what a keyframe replaces, nothing else."""

    def __init__(self) -> None:
        super().__init__()
        self.first, self.twin, self.other = (
            Outbox(1000, Counter(), flows=flows) for flows in (True, False, True)
        )
        self.sequence = 0
        self.got: dict[Outbox, list[Frame]] = {self.first: [], self.twin: [], self.other: []}

    @rule(stream=st.integers(1, 2), layer=st.sampled_from((0, 0, 1, 2)), is_key=st.booleans())
    def deliver_and_let_the_first_take(self, stream: int, layer: int, is_key: bool) -> None:
        self._deliver(stream, layer, is_key and layer == 0)
        self._take(self.first)
        self._take(self.twin)

    @rule(stream=st.integers(1, 2))
    def deliver_without_taking(self, stream: int) -> None:
        self._deliver(stream, 0, False)

    @rule()
    def the_other_takes(self) -> None:
        self._take(self.other)

    @rule(stream=st.integers(1, 2), layer=st.sampled_from((0, 1, 7, None)))
    def wish(self, stream: int, layer: int | None) -> None:
        for outbox in (self.first, self.twin):
            outbox.want(stream, layer)

    @rule(stream=st.integers(1, 2))
    def the_other_pauses(self, stream: int) -> None:
        self.other.interrupt(stream)

    @rule(stream=st.integers(1, 2))
    def a_stream_ends(self, stream: int) -> None:
        for outbox in self.got:
            outbox.forget_stream(stream)

    @invariant()
    def at_least_as_many_frames_wait_as_the_twin_has(self) -> None:
        assert self.first.waiting_frames >= self.twin.waiting_frames
        assert self.first.is_waiting >= self.twin.is_waiting

    @invariant()
    def nothing_comes_twice_or_out_of_order(self) -> None:
        for frames in self.got.values():
            for stream in (1, 2):
                numbers = [frame.sequence for frame in frames if frame.stream == stream]
                assert numbers == sorted(set(numbers))

    def teardown(self) -> None:
        self._take(self.first)
        self._take(self.twin)
        missed = [frame for frame in self.got[self.first] if frame not in self.got[self.twin]]
        assert [frame for frame in self.got[self.first] if frame not in missed] == self.got[
            self.twin
        ]
        assert all(self.replaced_by_keyframe(frame) for frame in missed)

    def replaced_by_keyframe(self, frame: Frame) -> bool:
        later = [f for f in self.got[self.twin] if f.stream == frame.stream]
        return any(f.is_keyframe and f.sequence > frame.sequence for f in later)

    def _deliver(self, stream: int, layer: int, is_key: bool) -> None:
        """As the hub does."""
        self.sequence += 1
        frame = arrived(stream, self.sequence, layer, is_key=is_key, num_bytes=0)
        for outbox in self.got:
            outbox.put(frame)

    def _take(self, outbox: Outbox) -> None:
        while (message := outbox.take()) is not None:
            frames = decode_media(message.data)
            assert len(frames) == len(message.received_s)
            self.got[outbox] += sorted(frames, key=lambda frame: frame.sequence)


TestTwins = Twins.TestCase
TestTwins.settings = settings(max_examples=200, stateful_step_count=40, deadline=None)
