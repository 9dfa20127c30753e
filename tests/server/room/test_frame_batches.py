from collections import Counter

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from pica_protocol.frames import Frame, decode_media, encode_frame
from pica_server.room.frame_batches import MAX_BUNDLE_FRAMES, Bundle, SharedFrames
from pica_server.room.outbox import Outbox

pytestmark = pytest.mark.unit


def encoded(stream: int, sequence: int) -> bytes:
    return encode_frame(
        Frame(stream=stream, sequence=sequence, captured_us=0, payload=bytes(6), is_keyframe=True)
    )


def bundle_of(*streams: int) -> Bundle:
    bundle = Bundle({})
    for index, stream in enumerate(streams):
        bundle.add(stream, encoded(stream, index), 0, True, now=float(index))
    return bundle


def test_receivers_of_the_same_streams_are_given_the_very_same_message() -> None:
    bundle = bundle_of(1, 2)
    message, moments = bundle.parcel({1, 2, 3})
    assert [frame.stream for frame in decode_media(message)] == [1, 2]
    assert moments == (0.0, 1.0)
    assert bundle.parcel({1, 2}).data is message


def test_nobody_is_given_frames_of_a_stream_that_does_not_flow_to_them() -> None:
    bundle = bundle_of(1, 2, 1)
    message, moments = bundle.parcel({2, 3})
    assert [(frame.stream, frame.sequence) for frame in decode_media(message)] == [(2, 1)]
    assert moments == (1.0,)


def test_a_bundle_is_full_long_before_a_message_is() -> None:
    bundle = bundle_of(*[1] * (MAX_BUNDLE_FRAMES - 1))
    assert not bundle.is_full
    bundle.add(1, encoded(1, 0), 0, True, now=0.0)
    assert bundle.is_full


def test_a_bundle_ends_only_when_something_is_in_it() -> None:
    shared = SharedFrames()
    first = shared.current
    assert shared.turn_over() is first
    first.add(1, encoded(1, 0), 0, True, now=0.0)
    assert shared.turn_over() is not first


class Twins(RuleBasedStateMachine):
    """Receivers of one room: two that may take bundles, and one that never does but is told and
    asked the same as the first. It misses what a keyframe replaces while it waits, nothing else."""

    def __init__(self) -> None:
        super().__init__()
        self.shared = SharedFrames()
        self.first, self.twin, self.other = (Outbox(1000, Counter()) for _ in range(3))
        self.first.shared = self.other.shared = self.shared
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
        frame = encode_frame(
            Frame(
                stream=stream,
                sequence=self.sequence,
                captured_us=0,
                payload=b"",
                layer=layer,
                is_keyframe=is_key,
            )
        )
        bundle = self.shared.current
        if bundle.is_full:
            bundle = self.shared.turn_over()
        for outbox in self.got:
            if stream in outbox.flowing and (outbox.newest is bundle or outbox.share(bundle)):
                continue
            outbox.put_frame(stream, frame, layer, is_key, now=0.0)
        bundle.add(stream, frame, layer, is_key, now=0.0)

    def _take(self, outbox: Outbox) -> None:
        while (parcel := outbox.take()) is not None:
            frames = decode_media(parcel.data)
            assert len(frames) == len(parcel.received_s)
            self.got[outbox] += sorted(frames, key=lambda frame: frame.sequence)


TestTwins = Twins.TestCase
TestTwins.settings = settings(max_examples=200, stateful_step_count=40, deadline=None)
