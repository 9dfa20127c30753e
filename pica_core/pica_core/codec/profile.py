"""The profile of a latent stream: what a frame's coefficients mean, and how likely they are.

Learned at export (`pica_core.train.stream_learning`) and carried by the avatar file under the names
``stream.*``. Integers throughout, so that all machines that read the same file make the same bytes
and the same latents.

A *frame* of the stream is C = K + 6 coefficients: K of the latent, then head rotation and
translation, 3 each. One unit of a latent coefficient is 1/64 of a root of rendered MSE: two latents
whose coefficients differ by n units in one place look different by MSE (n / 64)² on 0-255 values,
on average over faces and views. Pose units are 2⁻¹⁴ radians and 2⁻¹⁴ metres.

    name            type    shape    meaning
    mean            int32   [256]    latent of coefficients 0; unit 2⁻¹²
    analysis        int16   [256, K] latent to coefficients, after a shift of 16 bits
    synthesis       int16   [K, 256] coefficients to latent, after `synthesis_shift` bits
    synthesis_shift int32   [1]
    table_index     uint8   [K, 6]   which of `coefficient_frequencies`, by coefficient and context

The tables are the same for all avatars: a coefficient is 0 with one chance, and each magnitude is
so much rarer than the one before. Tables learned for each avatar save 1.6 % of a payload.

Symbols are coded by an integer range coder, bit-exact everywhere (`docs/wire.md`). Libraries write
whole words of 32 bits, a fifth of a frame too many.

Source: Martin, "Range encoding" (1979), in integers of 48 bits; the carry runs through ``low``.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from pica_core.errors import LatentError, ProfileError
from pica_core.types import NUM_LATENT, Array, Float64Array, FloatArray, Int64Array

TOTAL_BITS = 14
TOTAL = 1 << TOTAL_BITS
"""Frequencies of a table sum to this. With 14 bits the commonest symbol of 25 can cost as little as
0.002 bits."""
RANGE_BYTES = 6
_FULL_RANGE = 1 << (8 * RANGE_BYTES)
_LEAST_RANGE = _FULL_RANGE >> 8
MAX_PAYLOAD_BYTES = 512
"""Longest payload that is looked at; faces take 10 to 60."""

Range = tuple[int, int]
"""Start and frequency of one symbol."""


class Table(NamedTuple):
    """Frequencies of one alphabet: the range of each symbol, and the symbol of each slot."""

    ranges: tuple[Range, ...]
    symbol_of_slot: bytes


def make_table(frequencies: Sequence[int] | npt.NDArray[np.integer]) -> Table:
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


PREFIX = "stream."
NUM_POSE = 6
ESCAPE = 20
"""Coefficients of this magnitude and beyond are written as this and a rest."""
NUM_SYMBOLS = 2 * ESCAPE + 1
CHANCES = tuple(range(1, 32, 3))
"""In 32nds: of a 0, and of a magnitude against the one before; a table for each pair."""
NUM_TABLES = len(CHANCES) ** 2
ACTIVITY_LEVELS = (1, 4, 9, 20, 40)
"""Context thresholds on the sum of the last `ACTIVITY_WINDOW` magnitudes in the same frame."""
ACTIVITY_WINDOW = 16
NUM_CONTEXTS = len(ACTIVITY_LEVELS) + 1

LATENT_BITS = 12
"""Latents are integers of unit 2⁻¹² before and after the transform."""
MAX_LATENT = 1 << (LATENT_BITS + 8)
"""Latents beyond ±256 are clamped; real ones stay below 20."""
ANALYSIS_SHIFT = 16
UNITS_PER_RMSE = 64
MAX_COMPONENTS = 128
MAX_SYNTHESIS_SHIFT = 24

_ARRAYS: Mapping[str, tuple[type[np.integer[Any]], int, int, tuple[int, ...]]] = {
    "mean": (np.int32, -MAX_LATENT, MAX_LATENT, (NUM_LATENT,)),
    "analysis": (np.int16, -(1 << 15), (1 << 15) - 1, (NUM_LATENT, -1)),
    "synthesis": (np.int16, -(1 << 15), (1 << 15) - 1, (-1, NUM_LATENT)),
    "synthesis_shift": (np.int32, 0, MAX_SYNTHESIS_SHIFT, (1,)),
    "table_index": (np.uint8, 0, NUM_TABLES - 1, (-1, NUM_CONTEXTS)),
}
"""Type of each array, the smallest and the largest number that it may hold, and shape; -1 is K."""


@cache
def coefficient_frequencies() -> Int64Array:
    """Frequencies of coefficients 0, +1, -1, ..., +20, -20 in every table: chances of a 0 first,
    each with all chances of the magnitudes. Each row sums to `TOTAL`. ``[tables, symbols]``."""
    rows = []
    for zero in CHANCES:
        for ratio in CHANCES:
            weights = [1 << 30]
            while len(weights) < ESCAPE:
                weights.append(weights[-1] * ratio >> 5)
            weights[-1] = weights[-1] * 32 // (32 - ratio)  # all that lie beyond
            spare = (TOTAL - NUM_SYMBOLS) * (32 - zero)
            sides = [1 + spare * weight // (64 * sum(weights)) for weight in weights]
            rows.append([TOTAL - 2 * sum(sides), *(side for side in sides for _ in range(2))])
    return np.array(rows, np.int64)


@dataclass(frozen=True, kw_only=True, eq=False)
class StreamProfile:
    """See the module for the arrays.

    Raises:
        ProfileError: An array of the wrong type or shape, or a number out of range; names it.
    """

    mean: Array
    analysis: Array
    synthesis: Array
    synthesis_shift: Array
    table_index: Array

    def __post_init__(self) -> None:
        count = (*self.table_index.shape, 0)[0]
        if not 1 <= count <= MAX_COMPONENTS:
            raise ProfileError(
                f"{PREFIX}table_index has {count} rows; 1 to {MAX_COMPONENTS} are allowed"
            )
        for name, (kind, low, high, sides) in _ARRAYS.items():
            array, shape = getattr(self, name), tuple(count if n < 0 else n for n in sides)
            if array.dtype != kind or array.shape != shape:
                raise ProfileError(
                    f"{PREFIX}{name} is {array.dtype} {list(array.shape)}; "
                    f"{np.dtype(kind)} {list(shape)} is needed"
                )
            if array.min() < low or array.max() > high:
                raise ProfileError(
                    f"{PREFIX}{name} spans {array.min()} to {array.max()}; "
                    f"{low} to {high} is allowed"
                )
            array.flags.writeable = False

    @property
    def num_components(self) -> int:
        """K, coefficients of the latent."""
        return int(self.analysis.shape[1])

    @property
    def num_coefficients(self) -> int:
        """C, coefficients of a frame."""
        return self.num_components + NUM_POSE

    def to_tensors(self) -> dict[str, Array]:
        """The arrays under the names that they have in the avatar file."""
        return {PREFIX + item.name: getattr(self, item.name) for item in fields(self)}

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Array]) -> Self | None:
        """The profile among an avatar's tensors, or None if it has none.

        Raises:
            ProfileError: There is one that must not be used.
        """
        found = {name.removeprefix(PREFIX) for name in tensors if name.startswith(PREFIX)}
        if not found:
            return None
        if wrong := sorted(found.symmetric_difference(_ARRAYS)):
            raise ProfileError(f"tensor {PREFIX}{wrong[0]:.80} is missing or unknown")
        return cls(**{name: np.array(tensors[PREFIX + name]) for name in _ARRAYS})

    @cached_property
    def tables(self) -> tuple[tuple[Table, ...], ...]:
        """Tables of the latent's coefficients, by coefficient and context."""
        known = [make_table(row) for row in coefficient_frequencies()]
        return tuple(tuple(known[n] for n in row) for row in self.table_index.tolist())

    @cached_property
    def _exact(self) -> tuple[Float64Array, Float64Array]:
        # All sums stay below 2⁵³, so float64 is exact and BLAS may add in any order.
        return self.analysis.astype(np.float64), self.synthesis.astype(np.float64)

    def analyse(self, latent: npt.NDArray[np.floating[Any]]) -> Int64Array:
        """Coefficients, int64 ``[K]``, of a finite latent ``[256]``: row, column, channel."""
        scaled = np.rint(latent.astype(np.float64) * (1 << LATENT_BITS))
        offset = np.clip(scaled, -MAX_LATENT, MAX_LATENT) - self.mean
        sums = np.matmul(offset, self._exact[0]).astype(np.int64)
        return (sums + (1 << (ANALYSIS_SHIFT - 1))) >> ANALYSIS_SHIFT

    def synthesise(self, coefficients: Int64Array) -> FloatArray:
        """The latent of coefficients ``[K]``; float32 ``[256]``, exact, within ±256."""
        sums = np.matmul(coefficients.astype(np.float64), self._exact[1]).astype(np.int64)
        shift = int(self.synthesis_shift[0])
        units = ((sums + ((1 << shift) >> 1)) >> shift) + self.mean
        np.clip(units, -MAX_LATENT, MAX_LATENT, out=units)
        # 21 bits at most: exact in float32.
        return (units / (1 << LATENT_BITS)).astype(np.float32)
