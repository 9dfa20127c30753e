"""libopus by ctypes: sound survives, losses are concealed, and no stranger's packet harms."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fuzzing.damage import damaged_bytes
from pica_client.errors import VoiceError
from pica_client.voice import opus
from pica_client.voice.opus import FRAME_SAMPLES, MAX_LEVEL, OpusDecoder, OpusEncoder, level_of

pytestmark = [
    pytest.mark.unit,
    pytest.mark.skipif(opus.available() is not None, reason="needs libopus"),
]

SILENCE = np.zeros(FRAME_SAMPLES, np.float32)


def vowel(num_frames: int) -> np.ndarray:
    """A buzz with the formants' slope of a voice, in frames: float32 ``[num_frames, 960]``."""
    time_s = np.arange(num_frames * FRAME_SAMPLES) / 48_000
    tones = [np.sin(2 * np.pi * 140 * n * time_s) / n for n in range(1, 20)]
    return (0.2 * np.sum(tones, axis=0)).astype(np.float32).reshape(num_frames, FRAME_SAMPLES)


def test_a_voice_comes_back_with_its_pitch_and_loudness() -> None:
    encoder, decoder = OpusEncoder(), OpusDecoder()
    frames = vowel(50)
    packets = [encoder.encode(frame) for frame in frames]

    heard = np.concatenate([decoder.decode(packet) for packet in packets])[-9600:]

    assert None not in packets
    assert 15_000 < sum(len(packet or b"") for packet in packets) * 8 < 30_000
    said = np.abs(np.fft.rfft(frames.reshape(-1)[-9600:]))
    assert np.argmax(np.abs(np.fft.rfft(heard))) == np.argmax(said)
    assert 0.8 < np.std(heard) / np.std(frames[-10:]) < 1.2


@pytest.mark.parametrize("is_constant", [False, True])
def test_two_frames_in_one_packet_come_back_as_40_ms_and_silence_of_both_is_not_sent(
    is_constant: bool,
) -> None:
    encoder, decoder = OpusEncoder(is_constant=is_constant), OpusDecoder()
    pairs = vowel(50).reshape(25, -1)
    packets = [encoder.encode(pair) for pair in pairs]
    assert (len({len(packet or b"") for packet in packets}) == 1) == is_constant

    heard = [decoder.decode(packet) for packet in packets]

    assert {part.shape for part in heard} == {(2 * FRAME_SAMPLES,)}
    assert np.std(heard[-1]) == pytest.approx(np.std(pairs[-1]), rel=0.2)
    assert decoder.decode(None).shape == (FRAME_SAMPLES,)
    silent = [encoder.encode(np.zeros(2 * FRAME_SAMPLES, np.float32)) for _ in range(75)]
    assert sum(packet is not None for packet in silent[25:]) <= 6


def test_a_lost_packet_is_concealed_with_what_came_before() -> None:
    encoder, decoder = OpusEncoder(), OpusDecoder()
    for frame in vowel(20):
        decoder.decode(encoder.encode(frame))

    concealed = decoder.decode(None)

    assert np.std(concealed) > 0.5 * np.std(vowel(1))
    for _ in range(25):
        concealed = decoder.decode(None)
    assert np.std(concealed) < 0.1 * np.std(vowel(1))


@given(st.deferred(lambda: damaged_bytes([OpusEncoder().encode(f) or b"" for f in vowel(8)])))
@example(b"")
@example(b"\xfb\xff" + bytes(20))
def test_damaged_packets_decode_to_20_or_40_ms_of_sound_or_are_refused(payload: bytes) -> None:
    try:
        pcm = OpusDecoder().decode(payload)
    except VoiceError:
        return
    assert len(pcm) in (FRAME_SAMPLES, 2 * FRAME_SAMPLES)
    assert np.abs(pcm).max() <= 1.0


def test_a_frame_of_another_size_is_refused() -> None:
    with pytest.raises(VoiceError, match="cannot encode"):
        OpusEncoder().encode(SILENCE[:477])


def test_the_level_counts_decibels_below_full_scale() -> None:
    assert level_of(np.ones(FRAME_SAMPLES, np.float32)) == 0
    assert level_of(np.full(FRAME_SAMPLES, 0.1, np.float32)) == 20
    assert level_of(SILENCE) == MAX_LEVEL
