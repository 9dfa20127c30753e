"""A voice for tests of what plays it: packets that carry the place of their sound."""

import numpy as np

from pica_client.errors import VoiceError
from pica_client.voice.opus import FRAME_S
from pica_client.voice.opus import FRAME_SAMPLES as FRAME
from pica_client.voice.opus import SAMPLE_RATE_HZ as RATE_HZ
from pica_core.types import FloatArray
from pica_protocol.frames import Frame

CLOCK_OFFSET_US = 7_000_000_000
NETWORK_S = 0.03
"""Way of the fastest packet, from its last sample to its arrival."""


class SpokenDecoder:
    """Finds the sound of a packet where its payload says, a frame more for each byte beyond four;
    conceals with a loud hum."""

    def __init__(self, sound: FloatArray) -> None:
        self.sound, self.concealed = sound, 0

    def decode(self, payload: bytes | None) -> FloatArray:
        """A frame; an empty payload is a hostile one."""
        if payload is None:
            self.concealed += 1
            return np.full(FRAME, 0.25, np.float32)
        if not payload:
            raise VoiceError("payload of 0 bytes")
        place = int.from_bytes(payload[:4], "big") * FRAME
        return self.sound[place : place + FRAME * (len(payload) - 3)]


def hum(seconds: float, hz: float = 120.0) -> FloatArray:
    """A voice that never pauses: a tone with overtones."""
    times = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    waves = sum(np.sin(2 * np.pi * hz * part * times) / part for part in range(1, 8))
    return (0.1 * waves).astype(np.float32)


def packet(index: int, sequence: int | None = None) -> Frame:
    """The packet of a frame of the sound."""
    return Frame(
        stream=1,
        sequence=(index if sequence is None else sequence) % 65536,
        captured_us=CLOCK_OFFSET_US + round(index * FRAME_S * 1e6),
        payload=index.to_bytes(4, "big"),
    )


def usual_arrival_s(index: int) -> float:
    """When a frame's packet comes that nothing delays."""
    return (index + 1) * FRAME_S + NETWORK_S
