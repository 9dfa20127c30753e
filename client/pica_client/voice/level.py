"""How loud a frame is, as RFC 6464 counts it."""

import math

import numpy as np

from pica_client.voice.packet import MAX_LEVEL
from pica_core.types import FloatArray


def level_of(pcm: FloatArray) -> int:
    """Return decibels of the root mean square below full scale: 0 loud to 126 silent."""
    power = float(np.mean(np.square(pcm, dtype=np.float64)))
    return MAX_LEVEL if power <= 0 else min(max(round(-10 * math.log10(power)), 0), MAX_LEVEL)
