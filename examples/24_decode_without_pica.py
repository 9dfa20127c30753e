"""Decode the wire and the latent bitstream with none of this project's packages.

You learn what a receiver in another language has to do: docs/wire.md says all of it, and this is
written from that page. It decodes the golden vectors and checks what comes out.
"""

import hashlib
import json
import struct
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any

import msgpack
import numpy as np

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
        if len(payload) > 512 or payload.endswith(b"\0"):
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


def decode_frame(profile: dict[str, Any], payload: bytes) -> tuple[list[int], bool]:
    """Coefficients of a frame, and whether the face is still from here on."""
    coder = _RangeDecoder(payload)
    steps = profile["steps"][coder.symbol(profile["quality_table"])]
    header, num_latent = coder.symbol(profile["header_table"]), len(profile["table_index"])
    q = [0] * (num_latent + 6)
    for k in range(num_latent) if header & 1 else ():
        context = bisect_right((1, 4, 9, 20, 40), sum(map(abs, q[max(k - 16, 0) : k])))
        s = coder.symbol(profile["tables"][profile["table_index"][k][context]])
        magnitude = (s + 1) // 2
        if magnitude == 20:
            if (length := coder.number(4)) > 13:
                raise ValueError("no payload")
            magnitude = 19 + 2**length + coder.number(length)
        q[k] = magnitude if s % 2 else -magnitude
    for k, table in enumerate(profile["pose_tables"], num_latent) if header & 2 else ():
        if n := coder.symbol(table):
            q[k] = (1 - 2 * coder.number(1)) * (2 ** (n - 1) + coder.number(n - 1))
    c = [value * steps[max(0, (k - num_latent) // 3 + 1)] for k, value in enumerate(q)]
    if len(payload) > coder.next or max(map(abs, c)) > 65536:
        raise ValueError("no payload")
    return c, bool(header & 4)


def latent_of(profile: dict[str, Any], c: Sequence[int]) -> list[int]:
    """The latent of a frame, 256 whole numbers of 1/4096."""
    (shift,), units = profile["synthesis_shift"], []
    for mean, *column in zip(profile["mean"], *profile["synthesis"], strict=True):
        total = sum(map(int.__mul__, column, c)) + (1 << shift >> 1)
        units.append(min(max(mean + (total >> shift), -(2**20)), 2**20))
    return units


if __name__ == "__main__":
    for name, text in json.loads((GOLDEN / "wire.json").read_text())["valid"].items():
        data = bytes.fromhex(text)
        print(name, list(decode_media(data)) if data[0] == 2 else msgpack.unpackb(data[1:]))
    vectors = json.loads((GOLDEN / "stream.json").read_text())
    arrays = vectors["profile"].items()
    shaped = {name: np.reshape(a["values"], a["shape"]).tolist() for name, a in arrays}
    profile = shaped | vectors["fixed"]
    for quality, frames in vectors["streams"].items():
        for frame in frames:
            c, is_still = decode_frame(profile, bytes.fromhex(frame["payload"]))
            packed = struct.pack("<256i", *latent_of(profile, c))
            assert (c, is_still) == (frame["coefficients"], frame["is_still"])
            assert hashlib.sha256(packed).hexdigest() == frame["latent_sha256"]
        print(f"quality {quality}: {len(frames)} payloads decoded as they must be")
