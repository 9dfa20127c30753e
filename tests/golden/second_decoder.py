"""A second decoder of the latent bitstream, written from docs/bitstream.md alone.

Plain Python without numpy, and without a look at the first one: where the two agree, the page says
enough to write a third in another language. Slow and small on purpose.
"""

import hashlib
from collections.abc import Mapping
from typing import Any

Profile = Mapping[str, Any]
"""The arrays of the page by name, as nested lists."""


class DamagedError(Exception):
    """What the page calls an error."""


class _Coder:
    """Range coder."""

    def __init__(self, payload: bytes) -> None:
        if len(payload) > 512 or payload.endswith(b"\0"):
            raise DamagedError
        self.payload = payload
        self.range = 2**48
        self.next = 0
        self.code = 0
        for _ in range(6):
            self._take_byte()

    def symbol(self, frequencies: list[int]) -> int:
        r = self.range >> 14
        slot = self.code // r
        if slot >= 16384:
            raise DamagedError
        start = 0
        for s, frequency in enumerate(frequencies):
            if slot < start + frequency:
                self.code -= start * r
                self.range = r * frequency
                while self.range < 2**40:
                    self.range <<= 8
                    self._take_byte()
                return s
            start += frequency
        raise AssertionError("frequencies sum to 16384")

    def number(self, num_bits: int) -> int:
        return self.symbol([2 ** (14 - num_bits)] * 2**num_bits)

    def end(self) -> None:
        if len(self.payload) > self.next:
            raise DamagedError

    def _take_byte(self) -> None:
        byte = self.payload[self.next] if self.next < len(self.payload) else 0
        self.code = (self.code << 8) + byte
        self.next += 1


def decode(profile: Profile, payload: bytes) -> tuple[list[int], bool]:
    """Coefficients of one frame, and whether the sender falls silent after it."""
    coder = _Coder(payload)
    steps = profile["steps"][coder.symbol(profile["quality_table"])]
    header = coder.symbol(profile["header_table"])
    num_latent = len(profile["table_index"])
    values = [0] * len(steps)
    if header & 1:
        for k in range(num_latent):
            activity = sum(map(abs, values[max(k - 16, 0) : k]))
            context = sum(level <= activity for level in (1, 4, 9, 20, 40))
            values[k] = _coefficient(coder, profile["tables"][profile["table_index"][k][context]])
    if header & 2:
        for k, table in enumerate(profile["pose_tables"], num_latent):
            length = coder.symbol(table)
            if length:
                sign = -1 if coder.number(1) else 1
                low = min(length - 1, 12)
                upper = coder.number(length - 1 - low)
                values[k] = sign * (2 ** (length - 1) + upper * 2**low + coder.number(low))
    coder.end()
    c = [value * step for value, step in zip(values, steps, strict=True)]
    if max(map(abs, c)) > 65536:
        raise DamagedError
    return c, bool(header & 4)


def _coefficient(coder: _Coder, table: list[int]) -> int:
    s = coder.symbol(table)
    n = (s + 1) // 2
    if n == 20:
        length = coder.number(4)
        if length > 13:
            raise DamagedError
        n = 20 + 2**length + coder.number(length) - 1
    return n if s % 2 else -n


def latent_units(profile: Profile, c: list[int]) -> list[int]:
    """From coefficients to a face: z of the page, 256 whole numbers of 1/4096."""
    synthesis, shift = profile["synthesis"], profile["synthesis_shift"][0]
    half = (1 << shift) >> 1
    units = []
    for i, mean in enumerate(profile["mean"]):
        total = sum(row[i] * value for row, value in zip(synthesis, c, strict=False))
        units.append(min(max(mean + ((total + half) >> shift), -(2**20)), 2**20))
    return units


def profile_hash(profile: Mapping[str, Mapping[str, Any]]) -> str:
    """The name of a profile from its arrays as the golden file holds them: type, shape, values."""
    digest = hashlib.sha256(b"pica latent stream 2\n")
    for name in sorted(profile):
        array = profile[name]
        digest.update(f"{name} {array['type']} {array['shape']}\n".encode("ascii"))
        num_bytes = {"uint8": 1, "int16": 2, "uint16": 2, "int32": 4}[array["type"]]
        is_signed = array["type"].startswith("int")
        for value in array["values"]:
            digest.update(value.to_bytes(num_bytes, "little", signed=is_signed))
    return digest.hexdigest()
