"""The latent stream: faces in, a few bytes a frame out, and back. Every frame is decoded alone.

    encoder = LatentEncoder(profile, fps=30)
    frame = encoder.encode(latent, rotation, translation_m, now_us)      # None: nothing to say
    sample = LatentDecoder(profile).decode(frame.payload)

A frame is quantised coefficients of the latent and of the head pose:

    coefficient = value / step, rounded to the nearest, or towards 0 where that saves enough bits

`docs/wire.md` says how they are written.

So any frame may be dropped by anybody, and a late joiner decodes the next one. A receiver that
wants less gets the frames whose sequence number is a multiple of 2 or 4; `EncodedFrame.multiple`
sees to it that what everybody must get is among them. A face that does not change falls silent: one
last, finer frame says so, then a heartbeat four times a second keeps the stream alive, until
something moves by more than a tracker's noise.

All is integers. Nothing here knows of time or networks; `now_us` is an argument.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from pica_core.codec.profile import (
    ACTIVITY_LEVELS,
    ACTIVITY_WINDOW,
    ESCAPE,
    Range,
    StreamProfile,
    SymbolReader,
    Table,
    make_table,
    uniform,
    write_symbols,
)
from pica_core.errors import LatentError, ShapeError
from pica_core.types import (
    LATENT_SHAPE,
    MAX_LATENT_LENGTH,
    NUM_LATENT,
    Array,
    FloatArray,
    Int64Array,
)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LatentSample:
    """A face at one moment: the latent and the pose of the head."""

    latent: FloatArray
    """float32 ``[8, 8, 4]``."""
    rotation: FloatArray
    """Head to seat, rotation vector, radians. float32 ``[3]``."""
    translation_m: FloatArray
    """Head offset from its seat, metres. float32 ``[3]``."""
    is_still: bool = False
    """Whether the sender says that nothing changes until its next frame: a silence that follows is
    no gap, and ends one frame interval before the next frame."""


@dataclass(frozen=True, slots=True)
class EncodedFrame:
    """What goes onto the wire for one moment; it is decoded alone."""

    payload: bytes
    multiple: int = 1
    """Its sequence number is to be a multiple of this: receivers may ask for every second or fourth
    number."""


HAS_LATENT, HAS_POSE, IS_STILL = 1, 2, 4
REST_LENGTH_BITS = 4
"""What lies beyond an escape is written as its length in bits, so many, and then itself."""
MAX_REST_BITS = 13
POSE_UNIT = 2.0**-14
MAX_COEFFICIENT = 1 << 16
"""A decoder refuses coefficients beyond: 1000 times the largest rendered change there is."""
STEPS = (
    (80, 24, 5), (64, 20, 4), (48, 14, 3), (36, 12, 2), (28, 10, 2), (20, 8, 2), (14, 6, 1),
    (10, 4, 1),
)  # fmt: skip
"""By quality, the finest last: of the latent, in 64ths of a root of rendered MSE; of rotations, in
2⁻¹⁴ rad (a head turns by 2 to 4 mrad a frame; 12 is 0.7 mrad and leaves an error of 0.3 in its
steps from frame to frame, with 48 half of its motion was noise: docs/results.md); of translations,
in 2⁻¹⁴ m (2 is 0.12 mm, and a head moves by 0.2 to 0.4 mm a frame)."""
DEFAULT_QUALITY, BEST_QUALITY = 3, len(STEPS) - 1
QUALITY_TABLE = make_table((192, 192, 192, 11426, 3810, 191, 191, 190))
HEADER_TABLE = make_table((1, 2886, 2, 13169, 1, 59, 1, 265))
ROTATION_TABLE = make_table(
    (4599, 1900, 1350, 1850, 2450, 2150, 1450, 540, 60, 20, 8, 2, 2, 1, 1, 1)
)
TRANSLATION_TABLE = make_table(
    (4199, 2400, 1950, 2400, 2500, 1800, 860, 220, 30, 12, 6, 2, 2, 1, 1, 1)
)
"""How likely lengths of 0 to 15 bits are (counted of heads that nod, turn and rest)."""
POSE_TABLES = (*[ROTATION_TABLE] * 3, *[TRANSLATION_TABLE] * 3)
BIT_PRICE = 0.12
"""A bit less is worth so much more squared error of the latent, in squared steps (measured on two
avatars, a real recording: 0.08 to 0.16 are alike, 4 % of the bits at the same error; a dead zone,
which asks no table, held lips back)."""
LEAST_QUARTER_FPS = 5.0
"""What is left of a stream by the quarter of its sequence numbers, at least: less is a slide show.
Slower streams leave numbers out."""
MOVED_FACE, MOVED_POSE = 18, (8, 8, 8, 2, 2, 2)
"""How far a coefficient must move, in its units, for a face not to be still: a quarter of a root of
rendered MSE, half a milliradian, an eighth of a millimetre (chosen: below is what trackers do by
themselves)."""
STILL_AFTER_US = 250_000
"""A face that has not changed for so long falls silent."""
HEARTBEAT_US = 250_000
"""Time between two frames of a silent face."""
MAX_POSE = np.repeat((np.pi, 1.0), 3)
"""Rotation vectors (radians) and offsets (metres) are clamped to this: half a turn, an arm's length
about the chair."""


@cache
def steps_of(quality: int, num_components: int) -> Int64Array:
    """The step of each coefficient, ``[C]``, of which so many are the latent's."""
    steps = np.repeat(np.array(STEPS[quality], np.int64), (num_components, 3, 3))
    steps.flags.writeable = False
    return steps


def quantise(values: Int64Array, steps: Array) -> Int64Array:
    """Values in steps, rounded to the nearest."""
    magnitudes = (2 * np.abs(values) + steps) // (2 * steps)
    return np.where(values < 0, -magnitudes, magnitudes)


def spare_bits(
    profile: StreamProfile, values: Int64Array, quantised: Int64Array, step: int
) -> None:
    """Round coefficients towards 0, in place, where the bits are worth the error (`BIT_PRICE`).

    Args:
        values: Coefficients of the latent, ``[K]``.
        quantised: The same in steps, rounded to the nearest; others may follow.
    """
    activity = _Activity()
    for place, value in enumerate(np.abs(values).tolist()):
        number = int(quantised[place])
        magnitude, sign = abs(number), 1 if number > 0 else -1
        # Beyond the middle of two steps the error grows from e to 1 - e, squared by 1 - 2 e.
        grown = 1 - 2 * (magnitude - value / step)
        if grown < 1 and 0 < magnitude < ESCAPE:
            table = profile.tables[place][activity.context]
            (_, dear), (_, cheap) = (
                table.ranges[_symbol(sign * each)] for each in (magnitude, magnitude - 1)
            )
            if BIT_PRICE * math.log2(cheap / dear) > grown:
                magnitude -= 1
                quantised[place] = sign * magnitude
        activity.add(magnitude)


def encode_frame(
    profile: StreamProfile, quantised: Int64Array, quality: int, *, is_still: bool = False
) -> bytes:
    """Write one frame.

    Args:
        quantised: Coefficients in steps, ``[C]``, within `MAX_COEFFICIENT` when multiplied by them.
        quality: Row of `STEPS`.
        is_still: Whether the sender falls silent after it.
    """
    values: list[int] = quantised.tolist()
    face, pose = values[: profile.num_components], values[profile.num_components :]
    header = HAS_LATENT * any(face) + HAS_POSE * any(pose) + IS_STILL * is_still
    ranges = [QUALITY_TABLE.ranges[quality], HEADER_TABLE.ranges[header]]
    if header & HAS_LATENT:
        _write_face(ranges, face, profile.tables)
    if header & HAS_POSE:
        for value, table in zip(pose, POSE_TABLES, strict=True):
            length = abs(value).bit_length()
            ranges.append(table.ranges[length])
            if length:
                ranges.append(uniform(value < 0, 1))
                ranges.append(uniform(abs(value) - (1 << (length - 1)), length - 1))
    return write_symbols(ranges)


def decode_frame(profile: StreamProfile, payload: bytes) -> tuple[Int64Array, bool]:
    """Read one frame.

    Returns:
        Its coefficients, ``[C]``, and whether the sender falls silent after it.

    Raises:
        LatentError: The payload is no frame of this profile.
    """
    reader = SymbolReader(payload)
    quality, header = reader.read(QUALITY_TABLE), reader.read(HEADER_TABLE)
    values = [0] * profile.num_coefficients
    if header & HAS_LATENT:
        _read_face(reader, values, profile.tables)
    if header & HAS_POSE:
        for place, table in enumerate(POSE_TABLES, profile.num_components):
            if length := reader.read(table):
                is_negative = reader.read_uniform(1)
                magnitude = (1 << (length - 1)) + reader.read_uniform(length - 1)
                values[place] = -magnitude if is_negative else magnitude
    reader.finish()
    coefficients = np.array(values, np.int64) * steps_of(quality, profile.num_components)
    if np.abs(coefficients).max() > MAX_COEFFICIENT:
        raise LatentError(f"a coefficient is beyond the limit of {MAX_COEFFICIENT}")
    return coefficients, bool(header & IS_STILL)


class _Activity:
    """What the coefficients before one say of it: which of its tables is used.

    Attributes:
        context: Of the next coefficient.
    """

    def __init__(self) -> None:
        self.context = self._sum = 0
        self._magnitudes: list[int] = []

    def add(self, magnitude: int) -> None:
        """Go on to the next coefficient."""
        self._magnitudes.append(magnitude)
        self._sum += magnitude
        if len(self._magnitudes) > ACTIVITY_WINDOW:
            self._sum -= self._magnitudes[-ACTIVITY_WINDOW - 1]
        self.context = bisect_right(ACTIVITY_LEVELS, self._sum)


def _symbol(value: int) -> int:
    return 2 * min(abs(value), ESCAPE) - (value > 0)


def _write_face(
    ranges: list[Range], values: list[int], tables: tuple[tuple[Table, ...], ...]
) -> None:
    activity = _Activity()
    for value, contexts in zip(values, tables, strict=True):
        magnitude = abs(value)
        ranges.append(contexts[activity.context].ranges[_symbol(value)])
        if magnitude >= ESCAPE:
            rest = magnitude - ESCAPE + 1
            length = rest.bit_length() - 1
            ranges.append(uniform(length, REST_LENGTH_BITS))
            ranges.append(uniform(rest - (1 << length), length))
        activity.add(magnitude)


def _read_face(
    reader: SymbolReader, values: list[int], tables: tuple[tuple[Table, ...], ...]
) -> None:
    activity = _Activity()
    for place, contexts in enumerate(tables):
        symbol = reader.read(contexts[activity.context])
        magnitude = (symbol + 1) >> 1
        if magnitude >= ESCAPE:
            length = reader.read_uniform(REST_LENGTH_BITS)
            if length > MAX_REST_BITS:
                raise LatentError(f"a rest of {length} bits; the limit is {MAX_REST_BITS}")
            magnitude += (1 << length) + reader.read_uniform(length) - 1
        values[place] = magnitude if symbol & 1 else -magnitude
        activity.add(magnitude)


class LatentEncoder:
    """The sending end of one stream.

    Args:
        fps: Frames a second that `encode` is called with; decides which may be left out.
        quality: Row of `STEPS`; each step up costs about a quarter more bits.
    """

    def __init__(
        self, profile: StreamProfile, *, fps: float = 30.0, quality: int = DEFAULT_QUALITY
    ) -> None:
        self.profile, self._quality = profile, quality
        self._multiples: tuple[int, ...] = (4, 1, 2, 1)
        if fps < 4 * LEAST_QUARTER_FPS:
            self._multiples = (4, 2) if fps >= 2 * LEAST_QUARTER_FPS else (4,)
        self._moved = np.full(profile.num_coefficients, MOVED_FACE)
        self._moved[profile.num_components :] = MOVED_POSE
        self.restart()

    def restart(self) -> None:
        """Send the next face, however still it is: no receiver has seen what was sent before."""
        self._sent: Int64Array | None = None
        self._sent_us = self._phase = 0
        self._quiet_since_us: int | None = None
        self._is_silent = False

    def encode(
        self,
        latent: npt.ArrayLike,
        rotation: npt.ArrayLike,
        translation_m: npt.ArrayLike,
        now_us: int,
    ) -> EncodedFrame | None:
        """Encode the next frame.

        Args:
            latent: Expression code ``[8, 8, 4]``.
            rotation: Head pose, rotation vector, radians ``[3]``.
            translation_m: Offset from the seat, metres ``[3]``.
            now_us: Sender's clock, microseconds; never runs backwards.

        Returns:
            The frame to send, or None: the face is still.

        Raises:
            ShapeError: An argument of another shape.
            LatentError: A value that is not finite.
        """
        wanted = self._coefficients(latent, rotation, translation_m)
        is_quiet = self._sent is not None and bool(
            (np.abs(wanted - self._sent) < self._moved).all()
        )
        if self._is_silent:
            if is_quiet and now_us - self._sent_us < HEARTBEAT_US:
                return None
            self._phase = 0  # what ends a silence, or says that it goes on, is for everybody
        if not is_quiet:
            self._quiet_since_us = None
        elif self._quiet_since_us is None:
            self._quiet_since_us = now_us
        multiple = self._multiples[self._phase]
        if self._phase == 0:
            since_us = self._quiet_since_us
            self._is_silent = since_us is not None and now_us - since_us >= STILL_AFTER_US
        self._phase = (self._phase + 1) % len(self._multiples)
        quality = min(self._quality + self._is_silent, BEST_QUALITY)
        steps = steps_of(quality, self.profile.num_components)
        quantised = quantise(wanted, steps)
        spare_bits(self.profile, wanted[: self.profile.num_components], quantised, int(steps[0]))
        payload = encode_frame(self.profile, quantised, quality, is_still=self._is_silent)
        self._sent, self._sent_us = wanted, now_us
        return EncodedFrame(payload, multiple)

    def _coefficients(
        self, latent: npt.ArrayLike, rotation: npt.ArrayLike, translation_m: npt.ArrayLike
    ) -> Int64Array:
        values = np.asarray(latent, np.float64)
        pose = np.array((rotation, translation_m), np.float64)
        if values.shape != LATENT_SHAPE or pose.shape != (2, 3):
            raise ShapeError(
                f"latent is {values.shape} and the pose {pose.shape}; "
                f"{LATENT_SHAPE} and (2, 3) are needed"
            )
        if not (np.isfinite(values).all() and np.isfinite(pose).all()):
            raise LatentError("latent or pose holds a value that is not finite")
        units = np.rint(np.clip(pose.reshape(-1), -MAX_POSE, MAX_POSE) / POSE_UNIT)
        face = self.profile.analyse(values.reshape(NUM_LATENT))
        # Far from the limit of what is decoded: rounding must not step over it.
        np.clip(face, -MAX_COEFFICIENT // 2, MAX_COEFFICIENT // 2, out=face)
        return np.concatenate((face, units.astype(np.int64)))


class LatentDecoder:
    """The receiving end of one stream; it keeps nothing between frames."""

    def __init__(self, profile: StreamProfile) -> None:
        self.profile = profile

    def decode(self, payload: bytes) -> LatentSample:
        """Decode a frame.

        Raises:
            LatentError: The payload is no frame of this profile.
        """
        coefficients, is_still = decode_frame(self.profile, payload)
        count = self.profile.num_components
        pose = (coefficients[count:] * POSE_UNIT).astype(np.float32)
        latent = self.profile.synthesise(coefficients[:count])
        if (length := np.linalg.norm(latent)) > MAX_LATENT_LENGTH:
            latent *= np.float32(MAX_LATENT_LENGTH / length)
        return LatentSample(
            latent=latent.reshape(LATENT_SHAPE),
            rotation=pose[:3],
            translation_m=pose[3:],
            is_still=is_still,
        )
