"""What strangers send as their voice, on into libopus."""

from __future__ import annotations

import random
from functools import cache

import numpy as np

from fuzzing.meter import Meter
from fuzzing.mutator import Mutator
from fuzzing.targets import expect
from pica_client.errors import VoiceError
from pica_client.voice.opus import OpusDecoder, OpusEncoder
from pica_client.voice.packet import FRAME_SAMPLES


@cache
def payloads() -> list[bytes]:
    """Real payloads of 20 and 40 ms: noise that swells, at three bitrates."""
    chance = np.random.default_rng(1)
    found = []
    for bitrate in (12_000, 24_000, 48_000):
        encoder = OpusEncoder(bitrate, dtx=False)
        for loudness in (0.001, 0.01, 0.05, 0.1, 0.3, 0.5, 0.02):
            num_frames = 1 + len(found) % 2
            pcm = chance.normal(0, loudness, num_frames * FRAME_SAMPLES).astype(np.float32)
            found.append(encoder.encode(pcm) or b"\0")
    return found


def voice(rng: random.Random, meter: Meter) -> None:
    """Voice payloads: 20 or 40 ms of sound, or refused, and one decoder takes them all."""
    decoder, mutator = OpusDecoder(), Mutator(rng, payloads())
    for _ in range(50):
        original = rng.choice(payloads())
        is_noise = rng.random() < 0.2
        data = rng.randbytes(rng.randrange(200)) if is_noise else mutator.mutate_bytes(original)
        try:
            pcm = meter.call(decoder.decode, data)
        except VoiceError:
            meter.note("refused VoiceError")
            continue
        expect(pcm.shape in ((FRAME_SAMPLES,), (2 * FRAME_SAMPLES,)), "not 20 or 40 ms:", pcm.shape)
        expect(bool(np.abs(pcm).max() <= 1.0), "louder than can be:", data)
        meter.note("accepted")
