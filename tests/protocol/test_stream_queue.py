"""A queue against a publisher that refers to earlier frames and a reader that checks it."""

from collections import Counter

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from pica_protocol.frames import HEADER_BYTES, decode_media, media_message
from pica_protocol.limits import MAX_FRAME_BYTES
from pica_protocol.stream_queue import (
    MAX_WAITING_BASE,
    MAX_WAITING_BYTES,
    MAX_WAITING_S,
    MAX_WAITING_UPPER,
    Put,
    StreamQueue,
)
from simnet.layered import KEYFRAME, LayeredReader, LayeredWriter

pytestmark = pytest.mark.unit


class Line:
    """A publisher, a queue and a reader, one after the other."""

    def __init__(self) -> None:
        self.drops: Counter[str] = Counter()
        self.queue = StreamQueue(self.drops)
        self.writer = LayeredWriter()
        self.reader = LayeredReader()

    def send(self, *kinds: int, now: float = 0.0, num_bytes: int = 8) -> list[Put]:
        """Send frames: ``KEYFRAME``, or a layer."""
        fates = []
        for kind in kinds:
            frame = self.writer.frame(kind, num_bytes=num_bytes)
            fates.append(self.queue.put(frame, max(kind, 0), kind == KEYFRAME, now))
        return fates

    def read(self, max_bytes: int = 100_000) -> list[int]:
        """Take what waits, check that it can be decoded, and return the kinds of the frames."""
        frames = [item.frame for item in self.queue.take(max_bytes)]
        if not frames:
            return []
        return [self.reader.read(frame) for frame in decode_media(media_message(frames))]

    def resume(self, now: float = 0.0) -> None:
        """Offer what a relay keeps of the stream."""
        chain, is_whole = self.writer.chain()
        self.queue.resume(chain, is_whole=is_whole, now=now)


def test_a_reader_that_keeps_up_gets_everything_in_order() -> None:
    line = Line()
    for kind in (KEYFRAME, 2, 1, 2, 0, 2, 1, 2):
        line.send(kind)
        assert line.read() == [kind]
    assert not line.drops


def test_a_burst_of_one_base_period_passes_whole() -> None:
    line = Line()
    line.send(KEYFRAME, 2, 1, 2, 0)
    assert line.read() == [KEYFRAME, 2, 1, 2, 0]


def test_of_a_stream_of_keyframes_only_the_latest_waits() -> None:
    line = Line()
    line.send(KEYFRAME, KEYFRAME, KEYFRAME)
    assert line.drops == {"replaced": 2}
    assert line.read() == [KEYFRAME]
    assert line.reader.newest == line.writer.newest


def test_upper_layers_are_dropped_first_and_the_highest_before_the_lower() -> None:
    line = Line()
    line.send(KEYFRAME, 2, 1, 2, 0, 2, 1, 2, 0, 2, 1, 2)
    assert line.read() == [KEYFRAME, 1, 0, 1, 0, 1]
    assert line.drops == {"upper_replaced": 6}


def test_what_refers_to_a_dropped_frame_is_dropped_as_it_comes() -> None:
    line = Line()
    line.send(KEYFRAME, 1, 1, 1)
    assert line.send(1)[-1] is Put.WAITS  # the oldest goes
    line.queue.want(0)
    line.queue.want(2)
    assert line.send(2, 1, 2) == [Put.DROPPED] * 3
    assert line.send(0, 2) == [Put.WAITS] * 2
    assert line.read() == [KEYFRAME, 0, 2]


def test_too_many_base_frames_cut_the_stream_until_the_next_keyframe() -> None:
    line = Line()
    line.send(KEYFRAME)
    line.read()
    assert set(line.send(*[0] * MAX_WAITING_BASE)) == {Put.WAITS}
    assert line.send(0, 2, 0) == [Put.BEHIND, Put.DROPPED, Put.BEHIND]
    assert line.read() == []
    assert line.drops == {"base_cut": MAX_WAITING_BASE + 3}
    assert line.send(KEYFRAME, 0) == [Put.WAITS] * 2
    assert line.read() == [KEYFRAME, 0]


def test_upper_layers_stay_closed_after_a_cut_until_the_base_has_passed_for_a_while() -> None:
    line = Line()
    closed = []
    for _ in range(3):
        line.send(KEYFRAME)
        line.read()
        line.send(*[0] * (MAX_WAITING_BASE + 1))
        line.send(KEYFRAME)
        num_base = 0
        while line.read()[-1] != 2:
            line.send(0, 2)
            num_base += 1
        closed.append(num_base)
    # 8, 16 and 32 with the keyframe, less one for each base frame that passed in good times.
    assert closed == [7, 13, 25]


def test_base_frames_that_grew_old_cut_the_stream() -> None:
    line = Line()
    line.send(KEYFRAME, now=0.0)
    line.read()
    line.send(0, now=1.0)
    assert line.send(0, now=1.0 + MAX_WAITING_S) == [Put.WAITS]
    assert line.send(0, now=1.01 + MAX_WAITING_S) == [Put.BEHIND]
    assert line.read() == []


def test_an_old_frame_is_still_the_news_while_nothing_newer_comes() -> None:
    line = Line()
    line.send(KEYFRAME, 0, now=0.0)
    assert line.read() == [KEYFRAME, 0]  # an hour later, for all it knows


def test_a_cut_leaves_the_keyframe_that_waits() -> None:
    line = Line()
    line.send(KEYFRAME, 0, 0, now=0.0)
    assert line.send(0, now=9.0) == [Put.BEHIND]
    assert line.read() == [KEYFRAME]
    assert line.drops == {"base_cut": 3}


def test_bytes_are_bounded_too() -> None:
    line = Line()
    line.send(KEYFRAME, 0, 2, 0, 2, num_bytes=MAX_FRAME_BYTES - HEADER_BYTES)
    assert line.queue.num_bytes <= MAX_WAITING_BYTES
    line.send(0, num_bytes=MAX_FRAME_BYTES - HEADER_BYTES)
    assert line.drops["upper_replaced"] >= 1
    line.send(0, 0, num_bytes=MAX_FRAME_BYTES - HEADER_BYTES)
    assert line.queue.is_cut
    assert line.queue.num_bytes <= MAX_WAITING_BYTES


def test_a_reader_without_a_keyframe_gets_nothing_and_asks() -> None:
    line = Line()
    assert line.send(0, 1, 0) == [Put.KEYLESS, Put.DROPPED, Put.KEYLESS]
    assert line.drops == {"before_keyframe": 3}


def test_a_wish_for_less_holds_at_once_also_for_what_waits() -> None:
    line = Line()
    line.send(KEYFRAME, 2, 1, 2)
    assert line.queue.want(1) == 2
    assert line.read() == [KEYFRAME, 1]
    assert line.queue.want(0) == 0


def test_a_wish_for_more_holds_from_the_next_base_frame() -> None:
    line = Line()
    line.send(KEYFRAME)
    line.queue.want(0)
    line.queue.want(2)
    line.send(1, 2, 0, 2, 1)
    assert line.read() == [KEYFRAME, 0, 2, 1]
    assert line.drops == {"layer_thinned": 2}


def test_a_newcomer_decodes_at_once_from_the_keyframe_and_what_followed() -> None:
    line = Line()
    line.writer.frame(KEYFRAME)
    for kind in (2, 1, 2, 0, 2, 1):
        line.writer.frame(kind)
    line.resume()
    line.send(2, 0, 2)
    assert line.read() == [KEYFRAME, 0, 0, 2]


def test_a_newcomer_to_a_long_chain_sees_the_keyframe_and_waits_for_the_next() -> None:
    line = Line()
    line.writer.frame(KEYFRAME)
    for _ in range(100):
        line.writer.frame(0)
    line.resume()
    assert line.read() == [KEYFRAME]
    assert line.send(0, 1) == [Put.KEYLESS, Put.DROPPED]
    line.send(KEYFRAME, 0)
    assert line.read() == [KEYFRAME, 0]


def test_who_stopped_a_stream_goes_on_where_it_stood() -> None:
    line = Line()
    line.send(KEYFRAME, 0)
    assert line.read() == [KEYFRAME, 0]
    assert line.queue.want(None) == 0
    line.writer.frame(0)
    line.queue.want(2)
    line.resume()
    line.send(1, 0, 1)
    assert line.read() == [0, 0, 1]


def test_time_does_not_run_backwards_for_who_stopped_a_stream_with_a_long_chain() -> None:
    line = Line()
    line.send(KEYFRAME)
    line.read()
    for _ in range(100):
        line.send(0)
        line.read()
    line.queue.want(None)
    line.queue.want(2)
    line.resume()
    assert line.read() == []
    assert line.send(0) == [Put.KEYLESS]


class StreamQueueMachine(RuleBasedStateMachine):
    """Whatever happens, the reader decodes all it gets, in order, and is never forgotten."""

    def __init__(self) -> None:
        super().__init__()
        self.line = Line()
        self.now = 0.0
        self.wanted: int | None = 2
        self.has_asked = False
        self.put = self.out = self.unwanted = self.resumed = 0

    @rule(
        kinds=st.lists(st.sampled_from([KEYFRAME, 0, 0, 0, 1, 1, 2, 2, 3]), max_size=12),
        num_bytes=st.sampled_from([8, 30, 1184]),
    )
    def send(self, kinds: list[int], num_bytes: int) -> None:
        for kind in kinds:
            if self.wanted is None or kind > self.wanted:
                self.line.writer.frame(kind, num_bytes=num_bytes)  # the room keeps it away
                continue
            self.put += 1
            (fate,) = self.line.send(kind, now=self.now, num_bytes=num_bytes)
            if kind == KEYFRAME:
                assert fate is Put.WAITS
                self.has_asked = False
            self.has_asked |= fate in (Put.BEHIND, Put.KEYLESS)
            if kind == 0 and fate is not Put.WAITS:
                assert self.has_asked

    @rule(max_bytes=st.sampled_from([0, 30, 100, 2000, 100_000]))
    def read(self, max_bytes: int) -> None:
        self.out += len(self.line.read(max_bytes))

    @rule(seconds=st.sampled_from([0.033, 0.2, 3.0]))
    def wait(self, seconds: float) -> None:
        self.now += seconds

    @rule(layer=st.sampled_from([None, 0, 1, 2]))
    def want(self, layer: int | None) -> None:
        self.unwanted += self.line.queue.want(layer)
        if layer is not None and self.wanted is None:
            before = len(self.line.queue)
            self.line.resume(self.now)
            self.resumed += len(self.line.queue) - before
        self.wanted = layer

    @invariant()
    def it_is_bounded(self) -> None:
        queue = self.line.queue
        assert queue.num_bytes <= MAX_WAITING_BYTES
        assert len(queue) <= MAX_WAITING_BASE + MAX_WAITING_UPPER

    @invariant()
    def every_frame_is_accounted_for(self) -> None:
        gone = self.out + self.unwanted + sum(self.line.drops.values())
        assert self.put + self.resumed == gone + len(self.line.queue)

    def teardown(self) -> None:
        """A keyframe makes everything good."""
        if self.wanted is not None:
            self.line.send(KEYFRAME, 0, now=self.now)
            self.line.read()
            assert self.line.reader.newest == self.line.writer.newest


StreamQueueMachine.TestCase.settings = settings(max_examples=200, stateful_step_count=40)
TestStreamQueueMachine = StreamQueueMachine.TestCase
