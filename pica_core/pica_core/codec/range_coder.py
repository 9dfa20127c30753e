"""An integer range coder, bit-exact everywhere: symbols of static tables to bytes and back.

Libraries write whole words of 32 bits, a fifth of a frame too many. `docs/wire.md` has its steps.

Source: Martin, "Range encoding" (1979), in integers of 48 bits; the carry runs through ``low``.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from pica_core.errors import LatentError

TOTAL_BITS = 14
TOTAL = 1 << TOTAL_BITS
"""Frequencies of a table sum to this."""
RANGE_BYTES = 6
_FULL_RANGE = 1 << (8 * RANGE_BYTES)
_LEAST_RANGE = _FULL_RANGE >> 8
MAX_PAYLOAD_BYTES = 1280
"""Longest payload that is looked at; faces take 10 to 50, 200 of another encoder's latents."""

Range = tuple[int, int]
"""Start and frequency of one symbol."""


class Table(NamedTuple):
    """Frequencies of one alphabet: the range of each symbol, and the symbol of each slot."""

    ranges: tuple[Range, ...]
    symbol_of_slot: bytes


def make_table(frequencies: Sequence[int]) -> Table:
    """Prepare a table of frequencies: at least 1 each, `TOTAL` together, up to 256 symbols."""
    counts = np.asarray(frequencies, np.int64)
    starts = np.cumsum(counts) - counts
    ranges = tuple(zip(starts.tolist(), counts.tolist(), strict=True))
    symbols = np.repeat(np.arange(len(counts), dtype=np.uint8), counts)
    return Table(ranges, symbols.tobytes())


def uniform(value: int, num_bits: int) -> Range:
    """The range of a number of up to 14 bits, all values alike."""
    width = TOTAL >> num_bits
    return value * width, width


def write_symbols(ranges: Iterable[Range]) -> bytes:
    """Code symbols, in the order in which they will be read."""
    low, width, num_bits = 0, _FULL_RANGE, 8 * RANGE_BYTES
    for start, frequency in ranges:
        width >>= TOTAL_BITS
        low += start * width
        width *= frequency
        while width < _LEAST_RANGE:
            width <<= 8
            low <<= 8
            num_bits += 8
    shift = num_bits  # as few bytes as reach into the interval
    while (code := -(-low >> shift)) << shift >= low + width:
        shift -= 8
    return code.to_bytes((num_bits - shift) // 8, "big")


class SymbolReader:
    """Takes the symbols of one payload, in order; LatentError if no encoder wrote them."""

    def __init__(self, payload: bytes) -> None:
        if len(payload) > MAX_PAYLOAD_BYTES:
            raise LatentError(f"payload has {len(payload)} bytes; the limit is {MAX_PAYLOAD_BYTES}")
        if payload[-1:] == b"\0":
            raise LatentError("payload ends with a zero byte")
        self._payload = payload
        self._next = RANGE_BYTES
        head = payload[:RANGE_BYTES]
        self._code = int.from_bytes(head, "big") << (8 * (RANGE_BYTES - len(head)))
        self._width = _FULL_RANGE

    def read(self, table: Table) -> int:
        """Take a symbol of a table."""
        symbol = table.symbol_of_slot[self._slot()]
        self._take(*table.ranges[symbol])
        return symbol

    def read_uniform(self, num_bits: int) -> int:
        """Take a number of up to 14 bits."""
        value = self._slot() >> (TOTAL_BITS - num_bits)
        self._take(*uniform(value, num_bits))
        return value

    def finish(self) -> None:
        """Check that nothing is left; LatentError otherwise."""
        if len(self._payload) > self._next:
            raise LatentError(f"payload has {len(self._payload) - self._next} bytes too many")

    def _slot(self) -> int:
        self._width >>= TOTAL_BITS
        slot = self._code // self._width
        if slot >= TOTAL:
            raise LatentError("payload holds a code that no encoder writes")
        return slot

    def _take(self, start: int, frequency: int) -> None:
        self._code -= start * self._width
        self._width *= frequency
        while self._width < _LEAST_RANGE:
            place = self._next
            byte = self._payload[place] if place < len(self._payload) else 0
            self._code = (self._code << 8) | byte
            self._width <<= 8
            self._next = place + 1
