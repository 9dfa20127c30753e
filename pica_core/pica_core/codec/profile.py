"""What both ends of a latent stream share: transform, steps and integer probability tables.

Learned at export (`pica_core.train.stream_learning`) and carried by the avatar file under the names
``stream.*``. Everything is integers, so that two machines that read the same profile make the same
bytes and the same latents. `StreamProfile.hash` names it in the handshake.

A *frame* of the stream is C = K + 6 coefficients: K of the latent, then head rotation and
translation, 3 each. One unit of a latent coefficient is 1/64 of a root of rendered MSE: two latents
whose coefficients differ by n units in one place look different by MSE (n / 64)² on 0-255 values,
on average over faces and views. Pose units are 2⁻¹⁴ radians and 2⁻¹⁴ metres.

    name            type    shape    meaning
    mean            int32   [256]    latent of coefficients 0; unit 2⁻¹²
    analysis        int16   [256, K] latent to coefficients, after a shift of 16 bits
    synthesis       int16   [K, 256] coefficients to latent, after `synthesis_shift` bits
    synthesis_shift int32   [1]
    steps           int32   [Q, C]   quantiser step by quality, the last quality the finest
    tables          uint16  [N, 41]  frequencies of quantised coefficients, each row summing to 2¹⁴
    table_index     uint8   [K, 6]   which table, by coefficient of the latent and context
    pose_tables     uint16  [6, 25]  length in bits of a quantised pose coefficient
    header_table    uint16  [8]      what a frame holds: 1 latent, 2 pose, 4 stillness, added up
    quality_table   uint16  [Q]      quality of a frame
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Annotated, Any, Self, get_type_hints

import numpy as np
import numpy.typing as npt

from pica_core.codec.range_coder import TOTAL, Table, make_table
from pica_core.errors import ProfileError
from pica_core.latent import NUM_LATENT
from pica_core.types import Array, Float64Array, FloatArray, Int64Array

PREFIX = "stream."
FORMAT = "pica latent stream 2\n"
"""Begins the text that a profile's hash is taken of: arrays of the same numbers under another
bitstream are another profile."""
NUM_POSE = 6
ESCAPE = 20
"""Coefficients of this magnitude and beyond are written as this and a rest."""
NUM_SYMBOLS = 2 * ESCAPE + 1
NUM_HEADERS = 8
NUM_LENGTHS = 25
"""Lengths of a pose coefficient: 0 to 24 bits."""
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
POSE_BITS = 14
POSE_UNIT = 1.0 / (1 << POSE_BITS)
MAX_COEFFICIENT = 1 << 16
"""A decoder refuses coefficients beyond: 1000 times the largest rendered change there is."""
MAX_COMPONENTS = 128
MAX_QUALITIES = 16
MAX_TABLES = 256
MAX_STEP = 1 << 14
MAX_SYNTHESIS_SHIFT = 24


@dataclass(frozen=True, kw_only=True, eq=False)
class StreamProfile:
    """See the module for the arrays.

    Raises:
        ProfileError: An array of the wrong type or shape, a table that does not sum, or a number
            out of range; names it.
    """

    mean: Annotated[Array, np.int32]
    analysis: Annotated[Array, np.int16]
    synthesis: Annotated[Array, np.int16]
    synthesis_shift: Annotated[Array, np.int32]
    steps: Annotated[Array, np.int32]
    tables: Annotated[Array, np.uint16]
    table_index: Annotated[Array, np.uint8]
    pose_tables: Annotated[Array, np.uint16]
    header_table: Annotated[Array, np.uint16]
    quality_table: Annotated[Array, np.uint16]

    def __post_init__(self) -> None:
        for name, shape in self._shapes().items():
            array = getattr(self, name)
            if array.dtype != _TYPES[name] or array.shape != shape:
                raise ProfileError(
                    f"{PREFIX}{name} is {array.dtype} {list(array.shape)}; "
                    f"{np.dtype(_TYPES[name])} {list(shape)} is needed"
                )
            array.flags.writeable = False
        for name, low, high in (
            ("mean", -MAX_LATENT, MAX_LATENT),
            ("synthesis_shift", 0, MAX_SYNTHESIS_SHIFT),
            ("steps", 1, MAX_STEP),
            ("table_index", 0, len(self.tables) - 1),
        ):
            array = getattr(self, name)
            if array.min() < low or array.max() > high:
                raise ProfileError(
                    f"{PREFIX}{name} spans {array.min()} to {array.max()}; "
                    f"{low} to {high} is allowed"
                )
        for name in ("tables", "pose_tables", "header_table", "quality_table"):
            rows = np.atleast_2d(getattr(self, name)).astype(np.int64)
            sums = rows.sum(axis=1)
            if rows.min() < 1 or (sums != TOTAL).any():
                wrong = int(np.argmax((sums != TOTAL) | (rows.min(axis=1) < 1)))
                raise ProfileError(
                    f"{PREFIX}{name} row {wrong} sums to {sums[wrong]} with a smallest of "
                    f"{rows[wrong].min()}; {TOTAL} and at least 1 are needed"
                )

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        """The shapes that the arrays must have, free sizes taken from those there are."""

        def size(name: str, axis: int, high: int) -> int:
            shape = getattr(self, name).shape
            count = shape[axis] if len(shape) > axis else 0
            if not 1 <= count <= high:
                raise ProfileError(
                    f"{PREFIX}{name} has shape {list(shape)}; dimension {axis} may be 1 to {high}"
                )
            return int(count)

        components = size("analysis", 1, MAX_COMPONENTS)
        qualities = size("steps", 0, MAX_QUALITIES)
        return {
            "mean": (NUM_LATENT,),
            "analysis": (NUM_LATENT, components),
            "synthesis": (components, NUM_LATENT),
            "synthesis_shift": (1,),
            "steps": (qualities, components + NUM_POSE),
            "tables": (size("tables", 0, MAX_TABLES), NUM_SYMBOLS),
            "table_index": (components, NUM_CONTEXTS),
            "pose_tables": (NUM_POSE, NUM_LENGTHS),
            "header_table": (NUM_HEADERS,),
            "quality_table": (qualities,),
        }

    @property
    def num_components(self) -> int:
        """K, coefficients of the latent."""
        return int(self.analysis.shape[1])

    @property
    def num_coefficients(self) -> int:
        """C, coefficients of a frame."""
        return self.num_components + NUM_POSE

    @property
    def num_qualities(self) -> int:
        """How many qualities there are; the last is the finest."""
        return len(self.steps)

    @cached_property
    def hash(self) -> str:
        """SHA-256 over the format, names, types, shapes and little-endian contents, hexadecimal."""
        digest = hashlib.sha256(FORMAT.encode())
        for name in sorted(_TYPES):
            array = getattr(self, name)
            digest.update(f"{name} {array.dtype} {list(array.shape)}\n".encode())
            digest.update(array.astype(array.dtype.newbyteorder("<")).tobytes())
        return digest.hexdigest()

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
        if wrong := sorted(found.symmetric_difference(_TYPES)):
            raise ProfileError(f"tensor {PREFIX}{wrong[0]:.80} is missing or unknown")
        return cls(**{name: np.array(tensors[PREFIX + name]) for name in _TYPES})

    @cached_property
    def residual_tables(self) -> tuple[tuple[Table, ...], ...]:
        """Tables of the latent's coefficients, by coefficient and context."""
        tables = [make_table(row) for row in self.tables]
        return tuple(tuple(tables[n] for n in row) for row in self.table_index.tolist())

    @cached_property
    def frame_tables(self) -> tuple[Table, Table, tuple[Table, ...]]:
        """Tables of the quality, of the header, and of the lengths of pose coefficients."""
        pose = tuple(make_table(row) for row in self.pose_tables)
        return make_table(self.quality_table), make_table(self.header_table), pose

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


_TYPES: Mapping[str, type[np.integer[Any]]] = {
    name: hint.__metadata__[0]
    for name, hint in get_type_hints(StreamProfile, include_extras=True).items()
}
