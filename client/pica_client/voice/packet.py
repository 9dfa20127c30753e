"""The sizes of sound that a voice is captured, sent and played in. Pure.

The payload of a frame on a voice track is an Opus packet of 40 ms, mono, or of 20 ms where a mute
or a hole of the source leaves half of one.

During silence nothing is sent and ``sequence`` does not count on, ``captured_us`` does. So a hole
in ``sequence`` is a loss, and a leap of ``captured_us`` without one is a silence.
"""

import math
from typing import Final

import numpy as np

from pica_core.types import FloatArray

SAMPLE_RATE_HZ: Final = 48_000
FRAME_SAMPLES: Final = 960
FRAME_US: Final = 20_000
FRAME_S: Final = FRAME_US / 1e6
"""What is captured and played at once."""
PACKET_FRAMES: Final = 2
"""Frames in one packet, at most (chosen: two cost 20 ms of delay and save what surrounds every
other message, 63 bytes each 40 ms; PESQ is the same)."""
MAX_OPUS_BYTES: Final = 1000
"""The longest packet that is encoded (chosen; 128 kbit/s take 640 bytes)."""
MAX_LEVEL: Final = 126
"""The softest level, see `level_of`."""


def level_of(pcm: FloatArray) -> int:
    """Return decibels of the root mean square below full scale: 0 loud to 126 silent."""
    power = float(np.mean(np.square(pcm, dtype=np.float64)))
    return MAX_LEVEL if power <= 0 else min(max(round(-10 * math.log10(power)), 0), MAX_LEVEL)
