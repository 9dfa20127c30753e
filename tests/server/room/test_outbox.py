from collections import Counter

import pytest

from pica_protocol.frame_queue import QueuedFrame
from pica_protocol.frames import Frame, decode_media, encode_frame
from pica_protocol.limits import MAX_MEDIA_MESSAGE_BYTES
from pica_server.room.outbox import SLOW_MESSAGE_BYTES, SLOW_S, Outbox

pytestmark = pytest.mark.unit


def put(outbox: Outbox, stream: int, sequence: int = 0, size: int = 10, now: float = 0.0) -> None:
    frame = Frame(stream=stream, sequence=sequence, captured_us=0, payload=bytes(size))
    outbox.put(QueuedFrame(f"p{stream}", stream, encode_frame(frame), now, None))


def taken(outbox: Outbox, now: float = 0.0) -> list[tuple[int, int]]:
    message = outbox.take(now)
    frames = [] if message is None else decode_media(message.data)
    return [(frame.stream, frame.sequence) for frame in frames]


def test_a_receiver_that_keeps_up_gets_all_frames_of_a_turn_in_one_message() -> None:
    outbox = Outbox(Counter())
    for stream, sequence in ((1, 0), (2, 0), (1, 1)):
        put(outbox, stream, sequence)
    assert taken(outbox) == [(1, 0), (2, 0), (1, 1)]
    assert outbox.take(0.0) is None


def test_a_slow_receiver_gets_the_newest_frames_in_short_messages() -> None:
    drops: Counter[str] = Counter()
    outbox = Outbox(drops)
    outbox.note_full(now=0.0)
    for sequence in range(3):
        for stream in range(1, 5):
            put(outbox, stream, sequence, size=50)
    assert taken(outbox, 0.1) == [(stream, 2) for stream in range(1, 5)]
    assert drops == {"replaced": 8}
    assert outbox.is_slow(SLOW_S - 0.1)
    assert not outbox.is_slow(SLOW_S)


def test_a_message_to_a_slow_receiver_is_short() -> None:
    outbox = Outbox(Counter())
    outbox.note_full(now=0.0)
    for stream in range(1, 200):
        put(outbox, stream, size=2)
    message = outbox.take(0.0)
    assert message is not None
    assert SLOW_MESSAGE_BYTES - 10 < len(message.data) - 1 <= SLOW_MESSAGE_BYTES


def test_control_goes_before_frames_and_in_order() -> None:
    outbox = Outbox(Counter())
    put(outbox, 1)
    outbox.put_control(b"first")
    outbox.put_control(b"second")
    messages = [outbox.take(0.0) for _ in range(2)]
    assert [message and message.data for message in messages] == [b"first", b"second"]
    assert taken(outbox) == [(1, 0)]


def test_no_message_is_longer_than_the_limit() -> None:
    outbox = Outbox(Counter())
    for stream in range(1, 41):
        put(outbox, stream, size=1184)
    streams = []
    while (message := outbox.take(0.0)) is not None:
        assert len(message.data) <= MAX_MEDIA_MESSAGE_BYTES
        streams += [frame.stream for frame in decode_media(message.data)]
    assert streams == list(range(1, 41))


@pytest.mark.parametrize("is_slow", [False, True])
def test_what_waits_of_a_stream_that_stops_is_dropped(is_slow: bool) -> None:
    outbox = Outbox(Counter())
    if is_slow:
        outbox.note_full(now=0.0)
    put(outbox, 1)
    put(outbox, 2)
    assert outbox.drop("p1", 1) == 1
    assert taken(outbox) == [(2, 0)]
