from collections import Counter

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from pica_protocol.frames import FLAG_KEYFRAME, Frame, decode_media, encode_frame
from pica_protocol.limits import MAX_MEDIA_MESSAGE_BYTES
from pica_protocol.stream_queue import Put
from pica_server.errors import OutboxFullError
from pica_server.room.outbox import ArrivedFrame, Outbox

pytestmark = pytest.mark.unit

LIMIT = 100


def put(outbox: Outbox, stream: int, data: bytes, now: float = 0.0) -> None:
    """Put a frame of a stream of nothing but keyframes."""
    assert outbox.put(ArrivedFrame(stream, data, 0, FLAG_KEYFRAME, now)) is Put.WAITS


def put_delta(outbox: Outbox, stream: int, sequence: int, layer: int, num_bytes: int = 10) -> None:
    outbox.put(ArrivedFrame(stream, delta(stream, sequence, layer, num_bytes), layer, 0, 0.0))


def frame(stream: int, sequence: int = 0, num_bytes: int = 10) -> bytes:
    return encode_frame(
        Frame(
            stream=stream,
            sequence=sequence,
            captured_us=0,
            payload=bytes(num_bytes),
            is_keyframe=True,
        )
    )


def delta(stream: int, sequence: int, layer: int, num_bytes: int = 10) -> bytes:
    return encode_frame(
        Frame(
            stream=stream,
            sequence=sequence,
            captured_us=0,
            payload=bytes(num_bytes),
            layer=layer,
        )
    )


def test_a_newer_frame_replaces_the_waiting_one_of_its_stream() -> None:
    outbox = Outbox(LIMIT, Counter(), flows=False)
    put(outbox, 1, frame(1, sequence=0), now=0.0)
    put(outbox, 1, frame(1, sequence=1), now=0.1)
    message = outbox.take()
    assert message is not None
    assert message.data == b"\x02" + frame(1, sequence=1)
    assert message.received_s == (0.1,)
    assert outbox.take() is None


def test_frames_of_all_streams_leave_in_one_message_oldest_stream_first() -> None:
    outbox = Outbox(LIMIT, Counter(), flows=False)
    for stream, sequence in ((2, 0), (1, 0), (2, 1)):
        put(outbox, stream, frame(stream, sequence))
    message = outbox.take()
    assert message is not None
    assert message.data == b"\x02" + frame(2, sequence=1) + frame(1)


def test_control_goes_before_frames_and_in_order() -> None:
    outbox = Outbox(LIMIT, Counter(), flows=False)
    put(outbox, 1, frame(1))
    outbox.put_control(b"first")
    outbox.put_control(b"second")
    taken = [outbox.take() for _ in range(3)]
    assert [message.data for message in taken if message] == [
        b"first",
        b"second",
        b"\x02" + frame(1),
    ]


def test_no_message_is_longer_than_the_limit() -> None:
    outbox = Outbox(LIMIT, Counter(), flows=False)
    for stream in range(1, 41):
        put(outbox, stream, frame(stream, num_bytes=1184))
    streams = []
    while (message := outbox.take()) is not None:
        assert len(message.data) <= MAX_MEDIA_MESSAGE_BYTES
        streams += [frame.stream for frame in decode_media(message.data)]
    assert streams == list(range(1, 41))


def test_control_above_the_limit_is_refused_and_what_waited_is_kept() -> None:
    outbox = Outbox(LIMIT, Counter(), flows=False)
    outbox.put_control(bytes(60))
    with pytest.raises(OutboxFullError, match="60 bytes"):
        outbox.put_control(bytes(41))
    assert outbox.waiting_control_bytes == 60


def test_last_words_are_queued_whatever_the_limit_and_frames_are_dropped() -> None:
    outbox = Outbox(LIMIT, Counter(), flows=False)
    outbox.put_control(bytes(100))
    put(outbox, 1, frame(1))
    assert outbox.finish([b"goodbye"]) == 1
    taken = [outbox.take(), outbox.take(), outbox.take()]
    assert [message and message.data for message in taken] == [bytes(100), b"goodbye", None]


def test_several_frames_of_a_stream_wait_in_order_among_those_of_others() -> None:
    outbox = Outbox(LIMIT, Counter(), flows=False)
    put(outbox, 1, frame(1, sequence=0))
    put(outbox, 2, frame(2, sequence=0))
    for sequence, layer in ((1, 2), (2, 0)):
        put_delta(outbox, 1, sequence, layer)
    message = outbox.take()
    assert message is not None
    order = [(frame.stream, frame.sequence) for frame in decode_media(message.data)]
    assert order == [(1, 0), (1, 1), (1, 2), (2, 0)]


def test_a_stream_that_does_not_fit_goes_on_in_the_next_message() -> None:
    outbox = Outbox(LIMIT, Counter(), flows=False)
    for stream in range(1, 5):
        put(outbox, stream, frame(stream, sequence=0, num_bytes=1184))
        for sequence in range(1, 5):
            put_delta(outbox, stream, sequence, 0, num_bytes=1184)
    order = []
    while (message := outbox.take()) is not None:
        order += [(frame.stream, frame.sequence) for frame in decode_media(message.data)]
    assert order == [(stream, sequence) for stream in range(1, 5) for sequence in range(5)]


def test_a_wish_for_less_takes_back_what_waits() -> None:
    outbox = Outbox(LIMIT, Counter(), flows=False)
    put(outbox, 1, frame(1))
    put_delta(outbox, 1, 1, layer=2)
    assert outbox.want(1, 1) == 1
    assert outbox.want(1, None) == 1
    assert outbox.take() is None


def test_what_was_kept_of_a_stream_is_sent_again() -> None:
    outbox = Outbox(LIMIT, Counter(), flows=False)
    chain = [frame(1, 0), delta(1, 1, layer=0)]
    assert outbox.resume(1, chain, is_whole=True, now=3.0) == 2
    message = outbox.take()
    assert message is not None
    assert message.data == b"\x02" + b"".join(chain)
    assert outbox.take() is None


class OutboxMachine(RuleBasedStateMachine):
    """An outbox against two plain lists."""

    def __init__(self) -> None:
        super().__init__()
        self.drops: Counter[str] = Counter()
        self.outbox = Outbox(LIMIT, self.drops, flows=False)
        self.replaced = 0  # frames that gave way to a newer one
        self.control: list[bytes] = []
        self.frames: list[tuple[int, bytes]] = []
        self.counter = 0

    @rule(num_bytes=st.integers(1, 40))
    def put_control(self, num_bytes: int) -> None:
        data = bytes(num_bytes)
        if sum(map(len, self.control)) + num_bytes > LIMIT:
            with pytest.raises(OutboxFullError):
                self.outbox.put_control(data)
        else:
            self.outbox.put_control(data)
            self.control.append(data)

    @rule(stream=st.integers(1, 20), num_bytes=st.sampled_from([0, 100, 1184]))
    def put_frame(self, stream: int, num_bytes: int) -> None:
        self.counter += 1
        data = frame(stream, self.counter % 65_536, num_bytes)
        waiting = [index for index, (other, _) in enumerate(self.frames) if other == stream]
        put(self.outbox, stream, data)
        self.replaced += bool(waiting)
        if waiting:
            self.frames[waiting[0]] = (stream, data)
        else:
            self.frames.append((stream, data))

    @rule(stream=st.integers(1, 20))
    def forget_stream(self, stream: int) -> None:
        waited = any(other == stream for other, _ in self.frames)
        assert self.outbox.forget_stream(stream) == waited
        self.frames = [item for item in self.frames if item[0] != stream]

    @rule()
    def take(self) -> None:
        message = self.outbox.take()
        if self.control:
            assert message is not None
            assert message.data == self.control.pop(0)
        elif not self.frames:
            assert message is None
        else:
            assert message is not None
            expected = b"\x02"
            while self.frames and len(expected + self.frames[0][1]) <= MAX_MEDIA_MESSAGE_BYTES:
                expected += self.frames.pop(0)[1]
            assert message.data == expected

    @invariant()
    def it_is_bounded(self) -> None:
        assert self.drops["replaced"] == self.replaced
        assert self.outbox.waiting_frames == len(self.frames) <= 20
        assert self.outbox.waiting_control_bytes == sum(map(len, self.control)) <= LIMIT


OutboxMachine.TestCase.settings = settings(max_examples=60, stateful_step_count=40)
TestOutboxMachine = OutboxMachine.TestCase
