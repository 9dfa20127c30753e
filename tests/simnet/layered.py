"""A layered stream without a codec: each payload names the frame it refers to.

The references are those of the latent stream: a keyframe refers to nothing, another frame of layer
0 to the one of layer 0 before it, a frame of a higher layer to the latest frame of a lower one.
"""

import struct

from pica_protocol.frames import Frame, encode_frame
from pica_protocol.stream_queue import MAX_CHAIN_BYTES, MAX_CHAIN_FRAMES

KEYFRAME = -1
"""As the kind of a frame; the other kinds are the layers."""

DYADIC = (0, 2, 1, 2)
"""The layers of four frames in turn: base at a quarter of the rate, then a half, then all."""

_REFERENCE = struct.Struct(">ii")


class LayeredWriter:
    """Writes the frames of a stream, and keeps what a relay would keep for latecomers.

    Attributes:
        newest: Number of the newest base frame.
    """

    def __init__(self, stream: int = 1) -> None:
        self.newest = -1
        self._stream = stream
        self._number = 0
        self._latest: dict[int, int] = {}
        self._chain: list[bytes] = []
        self._is_whole = True

    def payload(self, kind: int, num_bytes: int = 8) -> bytes:
        """Return the payload of the next frame, its own number and that of its reference first."""
        number, self._number = self._number, self._number + 1
        lower = [n for layer, n in self._latest.items() if layer < max(kind, 1)]
        reference = -1 if kind == KEYFRAME else max(lower, default=-2)
        if kind == KEYFRAME:
            self._latest.clear()
        self._latest[max(kind, 0)] = number
        if kind <= 0:
            self.newest = number
        return _REFERENCE.pack(number, reference).ljust(num_bytes, b"\0")

    def frame(self, kind: int, num_bytes: int = 8) -> bytes:
        """Return the next frame, header included."""
        frame = Frame(
            stream=self._stream,
            sequence=self._number % 65_536,
            captured_us=0,
            payload=self.payload(kind, num_bytes),
            layer=max(kind, 0),
            is_keyframe=kind == KEYFRAME,
        )
        data = encode_frame(frame)
        if kind == KEYFRAME:
            self._chain, self._is_whole = [data], True
        elif kind == 0 and self._chain:
            size = sum(map(len, self._chain)) + len(data)
            if len(self._chain) == MAX_CHAIN_FRAMES or size > MAX_CHAIN_BYTES:
                self._is_whole = False
                del self._chain[1:]
            if self._is_whole:
                self._chain.append(data)
        return data

    def chain(self) -> tuple[list[bytes], bool]:
        """Return the latest keyframe and all base frames since, if they are few, and whether."""
        return list(self._chain), self._is_whole and bool(self._chain)


class LayeredReader:
    """Fails on a frame whose reference it has not got.

    Attributes:
        newest: Number of the newest base frame it got.
    """

    def __init__(self) -> None:
        self.newest = -1
        self._last = -1
        self._known: set[int] = set()

    def read(self, frame: Frame) -> int:
        """Take a frame and return its kind.

        Raises:
            AssertionError: It is out of order, or it cannot be decoded.
        """
        number, reference = _REFERENCE.unpack_from(frame.payload)
        assert number > self._last, f"frame {number} after {self._last}"
        assert frame.is_keyframe or reference in self._known, f"{number} refers to {reference}"
        self._last = number
        self._known.add(number)
        if frame.layer == 0:
            self.newest = number
        return KEYFRAME if frame.is_keyframe else frame.layer
