"""What waits for one receiver when somebody speaks: voices first, faces in their messages."""

import math
from collections import Counter
from typing import Any

import pytest

from pica_protocol.client_session import RIDE_S
from pica_protocol.frames import FLAG_KEYFRAME, Frame, decode_media, encode_frame
from pica_server.config.relay import RelayConfig
from pica_server.room.brake import FULL_BUSY_RATIO, Brake
from pica_server.room.hub import HOLD_STEP_S, Hub
from pica_server.room.outbox import (
    NARROW_MEMORY_S,
    NARROW_RIDE_S,
    NARROW_S,
    YIELDING_BYTES,
    ArrivedFrame,
    OutboundMessage,
    Outbox,
)

pytestmark = pytest.mark.unit

FACE, OTHER_FACE, VOICE, OTHER_VOICE = 1, 2, 3, 4
DEADLINE_S = 0.2


def outbox_with_voices(**options: Any) -> tuple[Outbox, Counter[str]]:
    drops: Counter[str] = Counter()
    outbox = Outbox(1000, drops, **options)
    for stream in (VOICE, OTHER_VOICE):
        outbox.open_ordered(stream, DEADLINE_S)
    return outbox, drops


def put(outbox: Outbox, stream: int, now: float, sequence: int = 0, num_bytes: int = 8) -> None:
    is_keyframe = stream in (FACE, OTHER_FACE)
    frame = Frame(
        stream=stream,
        sequence=sequence,
        captured_us=round(now * 1e6),
        payload=bytes(num_bytes),
        is_keyframe=is_keyframe,
    )
    flags = FLAG_KEYFRAME if is_keyframe else 0
    outbox.put(ArrivedFrame(stream, encode_frame(frame), 0, flags, now))


def streams(message: OutboundMessage | None) -> list[int]:
    return [] if message is None else [frame.stream for frame in decode_media(message.data)]


def test_a_voice_goes_at_once_before_the_faces_that_it_takes_along() -> None:
    outbox, _ = outbox_with_voices()
    put(outbox, FACE, 0.0)
    put(outbox, OTHER_FACE, 0.0)
    put(outbox, VOICE, 0.001)
    assert outbox.due_s(0.001) == 0.001
    assert streams(outbox.take(0.001)) == [VOICE, FACE, OTHER_FACE]


def test_nothing_waits_where_way_and_relay_are_ample() -> None:
    outbox, _ = outbox_with_voices()
    put(outbox, VOICE, 1.0)
    outbox.take(1.0)
    put(outbox, FACE, 1.005)
    assert outbox.due_s(1.005) == 1.005


@pytest.mark.parametrize("short", ["way", "core"])
def test_faces_wait_for_the_next_packet_of_who_speaks_but_not_for_long(short: str) -> None:
    brake = Brake()
    outbox, _ = outbox_with_voices(brake=brake)
    if short == "way":
        outbox.note_full(0.9)
    else:
        brake.note_turn(0.0, FULL_BUSY_RATIO, now=0.0)
    put(outbox, FACE, 0.0)
    assert outbox.due_s(0.0) == 0.0  # nobody speaks
    outbox.take(0.0)
    put(outbox, VOICE, 1.0)
    outbox.take(1.0)
    put(outbox, FACE, 1.005)
    assert outbox.due_s(1.005) == 1.0 + RIDE_S
    assert outbox.due_s(1.05) == 1.05
    put(outbox, VOICE, 1.04)
    assert outbox.due_s(1.04) == 1.04
    assert streams(outbox.take(1.04)) == [VOICE, FACE]


def test_a_control_message_waits_for_nobody() -> None:
    outbox, _ = outbox_with_voices()
    outbox.note_full(0.9)
    put(outbox, VOICE, 1.0)
    outbox.take(1.0)
    put(outbox, FACE, 1.005)
    outbox.put_control(b"hello")
    assert outbox.due_s(1.006) == 1.006


def test_nothing_older_than_the_deadline_is_sent_and_what_is_dropped_is_counted() -> None:
    outbox, drops = outbox_with_voices()
    for sequence in range(15):
        put(outbox, VOICE, sequence * 0.02, sequence)
    put(outbox, FACE, 0.28)
    message = outbox.take(0.4)
    assert message is not None
    assert [f.sequence for f in decode_media(message.data)] == [*range(10, 15), 0]
    assert drops == {"expired": 10}


def test_faces_yield_to_voices_of_a_narrow_receiver() -> None:
    outbox, _ = outbox_with_voices()
    outbox.note_full(0.0)
    for stream in (VOICE, OTHER_VOICE):
        put(outbox, stream, 1.0, num_bytes=60)
    for stream in (FACE, OTHER_FACE):
        put(outbox, stream, 1.0, num_bytes=100)
    message = outbox.take(1.03)
    assert message is not None
    assert streams(message)[:2] == [VOICE, OTHER_VOICE]
    faces = [frame for frame in decode_media(message.data) if frame.stream in (FACE, OTHER_FACE)]
    assert len(faces) == 1
    assert sum(len(encode_frame(frame)) for frame in faces) <= YIELDING_BYTES
    assert outbox.waiting_frames == 1


@pytest.mark.parametrize("num_bytes", [YIELDING_BYTES - 10, 255, 1000])
def test_beside_voices_a_large_face_takes_turns_with_others(num_bytes: int) -> None:
    outbox, _ = outbox_with_voices()
    outbox.note_full(0.0)
    counts: Counter[int] = Counter()
    face_bytes = 0
    for sequence in range(100):
        now = 0.04 * sequence
        put(outbox, FACE, now, sequence, num_bytes)
        put(outbox, OTHER_FACE, now, sequence, 40)
        put(outbox, VOICE, now, sequence, 60)
        message = outbox.take(now)
        assert message is not None
        frames = decode_media(message.data)
        counts.update(frame.stream for frame in frames)
        faces = [frame for frame in frames if frame.stream != VOICE]
        face_bytes += sum(len(encode_frame(frame)) for frame in faces)
        assert face_bytes <= YIELDING_BYTES * (sequence + 1)
    assert counts[VOICE] == 100
    assert counts[FACE] > 100 * YIELDING_BYTES // (3 * num_bytes)
    assert counts[OTHER_FACE] > 100 * YIELDING_BYTES // (3 * num_bytes)


def test_beside_voices_a_face_of_many_layers_leaves_room_for_others() -> None:
    outbox, _ = outbox_with_voices()
    outbox.note_full(0.0)
    counts: Counter[int] = Counter()
    for sequence in range(100):
        now = 0.04 * sequence
        for layer, num_bytes in enumerate((60, 50, 50)):
            frame = Frame(
                stream=FACE,
                sequence=sequence,
                captured_us=round(now * 1e6),
                payload=bytes(num_bytes),
                layer=layer,
                is_keyframe=layer == 0,
            )
            flags = FLAG_KEYFRAME if layer == 0 else 0
            outbox.put(ArrivedFrame(FACE, encode_frame(frame), layer, flags, now))
        put(outbox, OTHER_FACE, now, sequence, 40)
        put(outbox, VOICE, now, sequence, 60)
        counts.update(streams(outbox.take(now)))
    assert counts[FACE] > 50
    assert counts[OTHER_FACE] >= 50


def test_beside_a_voice_that_is_late_a_narrow_receiver_gets_no_face() -> None:
    outbox, _ = outbox_with_voices()
    outbox.note_full(0.0)
    for sequence in range(4):
        put(outbox, VOICE, 1.0 + 0.02 * sequence, sequence)
    put(outbox, FACE, 1.06)
    assert streams(outbox.take(1.08)) == [VOICE] * 4
    assert streams(outbox.take(1.2)) == [FACE]


def test_faces_alone_come_together_to_a_narrow_receiver() -> None:
    outbox, _ = outbox_with_voices()
    outbox.note_full(0.0)
    put(outbox, FACE, 1.0)
    outbox.take(1.0)
    put(outbox, FACE, 1.01)
    assert outbox.due_s(1.01) == 1.0 + NARROW_RIDE_S


def test_who_wants_no_voice_gets_none_and_who_wants_no_face_the_voice() -> None:
    outbox, _ = outbox_with_voices()
    outbox.want(VOICE, None)
    put(outbox, VOICE, 1.0)
    put(outbox, OTHER_VOICE, 1.0)
    outbox.want(FACE, None)
    assert streams(outbox.take(1.0)) == [OTHER_VOICE]


@pytest.mark.parametrize("step", range(1, 2000, 7))
def test_what_is_held_back_is_looked_at_when_it_is_due_and_not_before(step: int) -> None:
    hub = Hub(RelayConfig())
    connection = hub.connect(0.0)
    due_s = math.nextafter(step * HOLD_STEP_S, math.inf)
    hub.hold(connection, due_s)
    when = hub.next_timer()
    assert when is not None
    assert due_s <= connection.held_s <= due_s + 2 * HOLD_STEP_S
    assert when <= connection.held_s


def test_who_was_narrow_waits_for_a_keyframe_rather_than_for_all_since_the_last_one() -> None:
    outbox, _ = outbox_with_voices()
    assert outbox.takes_chain(4000, 1.0)
    outbox.note_full(1.0)
    assert not outbox.takes_chain(4000, 60.0)
    assert outbox.takes_chain(YIELDING_BYTES, 60.0)
    assert outbox.takes_chain(4000, 1.1 + NARROW_S + NARROW_MEMORY_S)
