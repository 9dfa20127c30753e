"""A second decoder of the latent bitstream, written from docs/bitstream.md alone.

Plain Python without numpy, and without a look at the first one: where the two agree, the page says
enough to write a third in another language. Slow and small on purpose.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

Profile = Mapping[str, Any]
"""The arrays of the page by name, as nested lists."""


class DamagedError(Exception):
    """What the page calls an error."""


class MissingError(Exception):
    """The reference is not there."""


@dataclass(frozen=True)
class Decoded:
    """What a decoder keeps of a frame."""

    number: int
    layer: int
    quality: int
    c: list[int]
    m: list[int]
    is_still: bool


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


def decode(
    profile: Profile,
    payload: bytes,
    *,
    number: int,
    layer: int,
    is_keyframe: bool,
    kept: Mapping[int, Decoded],
) -> Decoded:
    """One frame.

    Args:
        profile: The arrays.
        payload: Of the frame.
        number: The unwrapped sequence.
        layer: From the header.
        is_keyframe: From the header.
        kept: Frames decoded before, by number.
    """
    coder = _Coder(payload)
    reference = None
    num_qualities, num_coefficients = len(profile["steps"]), len(profile["steps"][0])
    num_latent = num_coefficients - 6
    if is_keyframe:
        if layer != 0:
            raise DamagedError
        kind = 0
        quality = coder.number(4)
        if quality >= num_qualities:
            raise DamagedError
    else:
        if layer not in (0, 1, 2):
            raise DamagedError
        reference = kept.get(number - (coder.symbol(profile["distance_tables"][layer]) + 1))
        if reference is None:
            raise MissingError
        kinds = {(0, 0): 1, (1, 0): 2, (2, 0): 3, (2, 1): 4}
        if (layer, reference.layer) not in kinds:
            raise DamagedError
        kind = kinds[layer, reference.layer]
        quality = (reference.quality + coder.symbol(profile["quality_table"])) % num_qualities
    header = coder.symbol(profile["header_tables"][kind])
    zeros = [0] * num_coefficients
    c_ref, m_ref = (zeros, zeros) if reference is None else (reference.c, reference.m)
    steps = profile["steps"][quality]
    residuals = list(zeros)
    for bit, section in (
        (1, range(num_latent)),
        (2, range(num_latent, num_coefficients)),
    ):
        if header & bit:
            for k in section:
                motion_level = sum(2 * abs(m_ref[k]) >= level * steps[k] for level in (1, 3, 7, 16))
                before = residuals[max(section.start, k - 16) : k]
                activity = sum(map(abs, before))
                activity_level = sum(level <= activity for level in (1, 4, 9, 20))
                index = profile["table_index"][kind][k][5 * motion_level + activity_level]
                residuals[k] = _residual(coder, profile["tables"][index])
    coder.end()
    c = []
    for k in range(num_coefficients):
        prediction = c_ref[k] + ((profile["gains"][kind][k] * m_ref[k]) >> 6)
        c.append(prediction + residuals[k] * steps[k])
        if abs(c[k]) > 65536:
            raise DamagedError
    m = zeros if reference is None else [c[k] - c_ref[k] for k in range(num_coefficients)]
    return Decoded(number, layer, quality, c, m, bool(header & 4))


def _residual(coder: _Coder, table: list[int]) -> int:
    s = coder.symbol(table)
    if s == 0:
        return 0
    n = (s + 1) // 2
    if n == 12:
        length = coder.number(4)
        if length > 13:
            raise DamagedError
        n = 12 + 2**length + coder.number(length) - 1
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
    digest = hashlib.sha256(b"pica latent stream 1\n")
    for name in sorted(profile):
        array = profile[name]
        digest.update(f"{name} {array['type']} {array['shape']}\n".encode("ascii"))
        num_bytes = {"uint8": 1, "int16": 2, "uint16": 2, "int32": 4}[array["type"]]
        is_signed = array["type"].startswith("int")
        for value in array["values"]:
            digest.update(value.to_bytes(num_bytes, "little", signed=is_signed))
    return digest.hexdigest()
