"""A voice packet in its frame: bytes that are fixed, and strangers' bytes that are refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from golden.wire_samples import FRAMES
from pica_client.errors import VoiceError
from pica_client.voice.packet import (
    MAX_OPUS_BYTES,
    VoicePacket,
    decode_payload,
    encode_payload,
)

pytestmark = pytest.mark.unit

packets = st.builds(
    VoicePacket,
    sequence=st.integers(0, 2**40),
    captured_us=st.integers(0, 2**63),
    payload=st.binary(min_size=1, max_size=MAX_OPUS_BYTES),
    level=st.none() | st.integers(0, 126),
    is_first=st.booleans(),
)


@given(packets)
def test_a_packet_comes_back_as_it_was(packet: VoicePacket) -> None:
    payload = encode_payload(packet)
    assert decode_payload(packet.sequence, packet.captured_us, payload) == packet


@given(st.binary(max_size=1100))
def test_any_payload_is_a_packet_or_refused(payload: bytes) -> None:
    try:
        packet = decode_payload(1, 2, payload)
    except VoiceError:
        assert not 2 <= len(payload) <= 1 + MAX_OPUS_BYTES
    else:
        assert encode_payload(packet) == payload


def test_the_first_byte_is_marker_and_level_of_rfc_6464() -> None:
    def first_byte(level: int | None, *, is_first: bool) -> str:
        return encode_payload(VoicePacket(0, 0, b"opus", level, is_first))[:1].hex()

    assert first_byte(30, is_first=False) == "1e"
    assert first_byte(30, is_first=True) == "9e"
    assert first_byte(None, is_first=False) == "7f"
    assert first_byte(0, is_first=True) == "80"


def test_the_golden_packet_is_the_first_after_a_silence_at_minus_30_decibels() -> None:
    (frame,) = FRAMES["voice packet"]
    packet = decode_payload(frame.sequence, frame.captured_us, frame.payload)
    assert packet == VoicePacket(7, 34_560_000, b"opus packet", level=30, is_first=True)
    assert encode_payload(packet) == frame.payload
