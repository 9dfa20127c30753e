"""What a simulated peer sends: opaque bytes with the sizes of a coded face. Pure.

Payload sizes are those of the coded stream at 30 frames a second (the shipped performance "talk",
default quality, so 20 bytes on average); the bytes themselves are noise. Unlike a real sender this
one never falls silent.
"""

import random
from collections.abc import Sequence
from typing import Final

SIZES: Final[Sequence[int]] = (2, 13, 16, 17, 19, 20, 21, 22, 24, 26, 37)
"""Payload bytes: minimum, deciles and maximum (measured)."""

LARGEST_FACE_BYTES: Final = 40
"""More is a voice: that is how a peer that counts tells them apart."""
VOICE_PAYLOAD: Final = bytes(121)
"""A packet of a voice at 24 kbit/s, with its first byte; libopus varies it, this does not."""


class Traffic:
    """The frames of one track."""

    def __init__(self, rng: random.Random) -> None:
        self.sequence = 0
        self._rng = rng
        self._noise = rng.randbytes(max(SIZES) + 8)

    def next_frame(self) -> tuple[int, bytes]:
        """Return sequence and payload of the next frame."""
        sequence, self.sequence = self.sequence, (self.sequence + 1) & 0xFFFF
        size = SIZES[int(self._rng.random() * len(SIZES))]
        return sequence, self._noise[:size]
