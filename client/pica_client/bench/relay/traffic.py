"""What a simulated peer sends: opaque bytes with the sizes and layers of a coded face. Pure.

Layers, keyframes and payload sizes are those of the coded stream at 30 frames a second (the shipped
performance "talk", one minute, default quality, so 6 bytes on average); the bytes themselves are
noise. Unlike a real sender this one never falls silent.
"""

import random
from collections.abc import Sequence
from typing import Final

LAYERS: Final = (0, 2, 1, 2)
"""Temporal layers of successive frames."""
SIZES: Final[dict[int, Sequence[int]]] = {
    0: (1, 2, 5, 7, 8, 9, 10, 11, 12, 14, 18),
    1: (1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 17),
    2: (0, 1, 2, 3, 4, 5, 5, 6, 7, 8, 13),
}
"""Payload bytes of a layer: minimum, deciles and maximum (measured)."""
KEYFRAME_SIZES: Final = (15, 15, 16, 16, 16, 16, 16, 17, 17, 21, 21)
KEYFRAME_INTERVAL_S: Final = 10.0
KEYFRAME_PAUSE_S: Final = 0.25
"""Keyframes come as from the real encoder: so often at least, and at most so soon after the last
one when asked."""

LARGEST_FACE_BYTES: Final = 40
"""More is a voice: that is how a peer that counts tells them apart."""
VOICE_PAYLOAD: Final = bytes(121)
"""A packet of a voice at 24 kbit/s, with its first byte; libopus varies it, this does not."""


class Traffic:
    """The frames of one track."""

    def __init__(self, rng: random.Random) -> None:
        self.sequence = 0
        self._rng = rng
        self._noise = rng.randbytes(max(KEYFRAME_SIZES) + 8)
        self._index = 0
        self._keyframe_us: int | None = None
        self._is_keyframe_wanted = True

    def request_keyframe(self) -> None:
        """Make the next base frame a keyframe, or one soon after."""
        self._is_keyframe_wanted = True

    def next_frame(self, now_us: int) -> tuple[int, int, bool, bytes]:
        """Return sequence, layer, whether it is a keyframe, and payload of the next frame."""
        layer = LAYERS[self._index]
        if (self._index == 0 or self._is_keyframe_wanted) and self._is_keyframe_due(now_us):
            layer, is_keyframe, self._index = 0, True, 0
            self._keyframe_us, self._is_keyframe_wanted = now_us, False
            sizes: Sequence[int] = KEYFRAME_SIZES
        else:
            is_keyframe, sizes = False, SIZES[layer]
        self._index = (self._index + 1) % len(LAYERS)
        sequence, self.sequence = self.sequence, (self.sequence + 1) & 0xFFFF
        size = sizes[int(self._rng.random() * len(sizes))]
        return sequence, layer, is_keyframe, self._noise[:size]

    def _is_keyframe_due(self, now_us: int) -> bool:
        if self._keyframe_us is None:
            return True
        since_s = (now_us - self._keyframe_us) / 1e6
        return since_s >= (KEYFRAME_PAUSE_S if self._is_keyframe_wanted else KEYFRAME_INTERVAL_S)
