"""Forty milliseconds of a voice as they travel, or twenty. Pure.

The payload of a frame on a voice track:

    offset  size  field
    0       1     bit 7: the first packet after a silence, a mute or a join; bits 0..6: the level
    1       1..   an Opus packet of 20 or 40 ms, mono

The level is that of RFC 6464: 0 is as loud as can be, each step one decibel less, 126 the softest;
127 does not say. Where payloads are sealed end to end it is sealed with the sound.

A silence is a gap: nothing is sent and ``sequence`` does not count on, ``captured_us`` does. So a
hole in ``sequence`` is a loss, and a leap of ``captured_us`` without one is a silence.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from pica_client.errors import VoiceError
from pica_core.types import FloatArray

SAMPLE_RATE_HZ: Final = 48_000
FRAME_SAMPLES: Final = 960
FRAME_US: Final = 20_000
FRAME_S: Final = FRAME_US / 1e6
"""What is captured and played at once."""
PACKET_FRAMES: Final = 2
"""Frames in one packet, at most (chosen: two cost 20 ms of delay and save what surrounds every
other message, 63 bytes each 40 ms; PESQ and STOI are the same)."""
MAX_OPUS_BYTES: Final = 1000
"""The longest packet that is read: a frame holds it, sealed and padded too (chosen; 128 kbit/s
take 320 bytes)."""
MAX_LEVEL: Final = 126
_UNSAID: Final = 127
_FIRST: Final = 0x80


@dataclass(frozen=True, slots=True)
class VoicePacket:
    """One packet of a voice."""

    sequence: int
    """Counts the packets, and wraps at 65536."""
    captured_us: int
    """When the first sample was captured, by the sender's clock, which its face's frames share."""
    payload: bytes
    """What `pica_client.voice.opus` encodes and decodes."""
    level: int | None = None
    """How loud it is, in decibels below the loudest: 0 to 126; None: not said."""
    is_first: bool = False
    """Whether it follows a silence: the best moment to change the delay."""


def encode_payload(packet: VoicePacket) -> bytes:
    """Return the payload of the frame that carries a packet."""
    level = _UNSAID if packet.level is None else min(max(packet.level, 0), MAX_LEVEL)
    return bytes([level | (_FIRST if packet.is_first else 0)]) + packet.payload


def decode_payload(sequence: int, captured_us: int, payload: bytes) -> VoicePacket:
    """Return the packet that a frame carries.

    Raises:
        VoiceError: It holds no sound, or too much.
    """
    if not 2 <= len(payload) <= 1 + MAX_OPUS_BYTES:
        raise VoiceError(
            f"a voice payload of {len(payload)} bytes, 2 to {1 + MAX_OPUS_BYTES} are read"
        )
    level = payload[0] & ~_FIRST
    return VoicePacket(
        sequence=sequence,
        captured_us=captured_us,
        payload=payload[1:],
        level=None if level == _UNSAID else level,
        is_first=bool(payload[0] & _FIRST),
    )


def level_of(pcm: FloatArray) -> int:
    """Return decibels of the root mean square below full scale: 0 loud to 126 silent."""
    power = float(np.mean(np.square(pcm, dtype=np.float64)))
    return MAX_LEVEL if power <= 0 else min(max(round(-10 * math.log10(power)), 0), MAX_LEVEL)
