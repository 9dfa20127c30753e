from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.strategies import frames
from pica_protocol.errors import RemoteProtocolError
from pica_protocol.frames import (
    MAX_PAYLOAD_BYTES,
    TICK_MODULUS,
    TICK_US,
    Frame,
    decode_media,
    encode_frame,
    media_message,
    scan_frames,
    sequence_distance,
    unwrap_time_us,
)
from pica_protocol.limits import MAX_FRAME_BYTES, MAX_MEDIA_MESSAGE_BYTES

pytestmark = pytest.mark.unit


@given(st.lists(frames, min_size=1, max_size=8))
def test_frames_survive_the_wire_together(batch: list[Frame]) -> None:
    times = {frame.stream: frame.captured_us for frame in batch}
    distinct = list({frame.stream: frame for frame in batch}.values())
    wire = media_message(map(encode_frame, distinct))
    expected = [replace(f, captured_us=f.captured_us // TICK_US * TICK_US) for f in distinct]
    assert decode_media(wire, times.__getitem__) == expected


def test_the_longest_frame_fits_a_datagram() -> None:
    frame = Frame(stream=1, sequence=0, captured_us=0, payload=bytes(MAX_PAYLOAD_BYTES))
    assert len(encode_frame(frame)) == MAX_FRAME_BYTES


@pytest.mark.parametrize(
    ("header", "complaint"),
    [
        ("0000 0000 00000000", "stream 0"),
        ("0001 0000 000004a9", "1193 bytes of payload.*the limit is 1192"),
        ("0001 0000 00000005", "5 bytes of payload, of which 0 are there"),
        ("0001 0000 00000000 00", "cut off after 1 bytes"),
    ],
)
def test_a_bad_frame_is_refused_with_its_value_and_limit(header: str, complaint: str) -> None:
    with pytest.raises(RemoteProtocolError, match=complaint):
        scan_frames(b"\x02" + bytes.fromhex(header))


def test_a_message_longer_than_the_limit_is_refused() -> None:
    frame = encode_frame(Frame(stream=1, sequence=0, captured_us=0, payload=bytes(1000)))
    with pytest.raises(RemoteProtocolError, match=str(MAX_MEDIA_MESSAGE_BYTES)):
        scan_frames(media_message([frame] * 17))


@pytest.mark.parametrize(
    ("sequence", "reference", "distance"),
    [(5, 3, 2), (3, 5, -2), (0, 65_535, 1), (65_535, 0, -1), (7, 7, 0), (40_000, 0, -25_536)],
)
def test_sequences_are_compared_across_the_wrap(
    sequence: int, reference: int, distance: int
) -> None:
    assert sequence_distance(sequence, reference) == distance


@given(time_us=st.integers(0, 10**12), error_us=st.integers(-100_000_000, 100_000_000))
def test_a_time_is_unwrapped_to_the_one_nearest_to_what_is_expected(
    time_us: int, error_us: int
) -> None:
    near_us = max(time_us + error_us, 0)
    ticks = time_us // TICK_US
    assert unwrap_time_us(ticks % TICK_MODULUS, near_us) == ticks * TICK_US
