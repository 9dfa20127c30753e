"""Decode the wire and the latent bitstream with none of this project's packages.

You learn what a receiver in another language has to do: docs/wire.md says all of it, and this is
written from that page. It decodes the golden vectors and checks what comes out.
"""

import json
import struct
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any

import msgpack

GOLDEN = Path(__file__).parents[1] / "tests" / "golden"


def decode_media(message: bytes) -> Iterator[tuple[int, int, int, bytes]]:
    """Stream, sequence, capture time (0.1 ms) and payload of each frame in a media message."""
    end = 1
    while end < len(message):
        stream, sequence, word = struct.unpack_from(">HHI", message, end)
        begin, end = end + 8, end + 8 + (word & 2047)
        yield stream, sequence, word >> 11, message[begin:end]


class _RangeDecoder:
    def __init__(self, payload: bytes) -> None:
        if len(payload) > 1280 or payload.endswith(b"\0"):
            raise ValueError("no payload")
        self.payload, self.next, self.range = payload, 6, 2**48
        self.code = int.from_bytes(payload[:6].ljust(6, b"\0"), "big")

    def symbol(self, frequencies: Sequence[int]) -> int:
        starts, r = [0, *accumulate(frequencies)], self.range >> 14
        symbol = bisect_right(starts, self.code // r) - 1
        if symbol >= len(frequencies):
            raise ValueError("no payload")
        self.code, self.range = self.code - starts[symbol] * r, frequencies[symbol] * r
        while self.range < 2**40:
            byte = self.payload[self.next] if self.next < len(self.payload) else 0
            self.code, self.range, self.next = self.code << 8 | byte, self.range << 8, self.next + 1
        return symbol

    def number(self, num_bits: int) -> int:
        return self.symbol([2 ** (14 - num_bits)] * 2**num_bits)


def decode_frame(fixed: dict[str, Any], payload: bytes) -> tuple[list[int], bool]:
    """Coefficients of a frame, and whether the face is still from here on."""
    coder = _RangeDecoder(payload)
    fineness = fixed["fineness"][coder.symbol(fixed["quality_table"])]
    header = coder.symbol(fixed["header_table"])
    q = [0] * (58 + 32 * (header & 8))
    for k in (*range(52 * (header & 1)), *range(52, 52 + 3 * (header & 2)), *range(58, len(q))):
        first = fixed["first"][k]
        q[k] = q[first] if first >= 0 else 0
        if n := coder.symbol(fixed["length_tables"][fixed["tables"][k]]):
            sign = 1 - 2 * coder.number(1) if first >= 0 or k >= 52 else 1
            q[k] += sign * (2 ** (n - 1) + coder.number(n - 1))
    steps = (max(step * fineness // 16, 1) for step in fixed["steps"])
    c = [number * step for number, step in zip(q, steps, strict=False)]
    if len(payload) > coder.next or max(map(abs, c)) > 65536 or min(c[:52]) < 0:
        raise ValueError("no payload")
    return c, bool(header & 4)


if __name__ == "__main__":
    for name, text in json.loads((GOLDEN / "wire.json").read_text())["valid"].items():
        data = bytes.fromhex(text)
        print(name, list(decode_media(data)) if data[0] == 2 else msgpack.unpackb(data[1:]))
    vectors = json.loads((GOLDEN / "stream.json").read_text())
    for quality, frames in vectors["streams"].items():
        for frame in frames:
            found = decode_frame(vectors["fixed"], bytes.fromhex(frame["payload"]))
            assert found == (frame["coefficients"], frame["is_still"])
        print(f"quality {quality}: {len(frames)} payloads decoded as they must be")
