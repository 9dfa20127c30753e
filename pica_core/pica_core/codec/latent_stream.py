"""The latent stream: faces in, a few bytes a frame out, and back. Every frame is decoded alone.

    encoder = LatentEncoder(avatar, fps=30)
    frame = encoder.encode(arkit, rotation, translation_m, now_us, latent=latent)  # None: still
    sample = LatentDecoder(avatar).decode(frame.payload)

A latent is predicted by the expression encoder in the avatar file, of 52 values that stand in the
frame, and the frame holds what is left of it. Of a face that was driven by such values nothing is
left: they say the latent in a third less bits than transforms of its 256 numbers, learned for each
avatar, at the same error of the picture, as they are few, most of them 0, none below, and alike on
both sides of a face. A latent of any other encoder, as that of a capture, is all left over.

    latent      = expression encoder(values) + rest
    coefficient = value / step, rounded to the nearest, or of shapes towards what predicts it where
                  that saves enough bits

A shape of the other side is predicted by the first side's; all else by 0. `docs/wire.md` says how
they are written.

So any frame may be dropped by anybody, and a late joiner decodes the next one. A receiver that
wants less gets the frames whose sequence number is a multiple of 2 or 4; `EncodedFrame.multiple`
sees to it that what everybody must get is among them. A face that does not change falls silent: one
last, finer frame says so, then a heartbeat four times a second keeps the stream alive, until
something moves by more than a tracker's noise.

Payloads are integers, and alike on all machines. Nothing here knows of time or networks; `now_us`
is an argument.
"""

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar
from pica_core.codec.range_coder import (
    TOTAL,
    SymbolReader,
    Table,
    make_table,
    uniform,
    write_symbols,
)
from pica_core.errors import LatentError, ShapeError
from pica_core.files import packaged_json
from pica_core.types import LATENT_SHAPE, MAX_LATENT_LENGTH, NUM_LATENT, FloatArray, Int64Array


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


HAS_FACE, HAS_POSE, IS_STILL, HAS_REST = 1, 2, 4, 8
SHAPE_UNIT, POSE_UNIT, REST_UNIT = 2.0**-12, 2.0**-14, 2.0**-10
"""Of shape values; of radians and metres; of the rest of a latent."""
_TABLES = packaged_json("pica_core.codec", "tables.json")
"""The numbers of `docs/wire.md`."""
QUALITY_TABLE, HEADER_TABLE = make_table(_TABLES["quality"]), make_table(_TABLES["header"])
SHAPE_STEPS: list[int] = _TABLES["shape_steps"]
"""How finely each shape is told at the usual quality, in its unit: inverse to what it changes in a
picture, blurred over 4 pixels, as edges that move by less than the avatar's own error cost nothing
(measured: three avatars, six faces each, views of `pica bench drive`)."""
SHAPE_TABLES: list[int] = _TABLES["shape_tables"]
"""The row of `LENGTH_TABLES` of each shape."""
FIRST_SIDES: list[int] = _TABLES["first_sides"]
"""The shape that predicts each shape: of the left side, or of the eye that looks the same way; -1
is none."""
LENGTH_TABLES = tuple(map(make_table, _TABLES["lengths"]))
"""How likely numbers of 0 to 15 bits are: eight for shapes, counted of generated faces, those as
trackers send them twice; one for rotations and one for translations, of heads that nod, turn and
rest."""
ROTATION_STEP, TRANSLATION_STEP = 12, 2
"""0.7 mrad and 0.12 mm (a head turns by 2 to 4 mrad a frame and moves by 0.2 to 0.4 mm; with four
times the step half of its motion was noise: docs/results.md)."""
REST_STEP, REST_TABLE = 32, 4
"""How finely the rest of a latent is told, and the row of its lengths (chosen)."""
FINENESS = (36, 28, 21, 16, 12, 9, 6, 4)
"""By quality, the finest last: 16ths of the usual steps."""
DEFAULT_QUALITY, BEST_QUALITY = 3, len(FINENESS) - 1
BIT_PRICE = 0.15
"""A bit less is worth so much more squared error of a shape, in squared steps (measured on a real
recording: 0.1 to 0.2 are alike, 0 takes a tenth more bits at the same error)."""
LEAST_QUARTER_FPS = 5.0
"""What is left of a stream by the quarter of its sequence numbers, at least: less is a slide show.
Slower streams leave numbers out."""
STILL_AFTER_US = 250_000
"""A face that has not changed for so long, by a usual step, falls silent."""
HEARTBEAT_US = 250_000
"""Time between two frames of a silent face."""
MAX_SHAPE = 2.0
"""Shape values are clamped to 0 and this; trackers overshoot 1 a little."""
MAX_POSE = np.repeat((np.pi, 1.0), 3)
"""Rotation vectors (radians) and offsets (metres) are clamped to this: half a turn, an arm's length
about the chair."""
MAX_REST = 16.0
"""What is left of each number of a latent is clamped to this; codes are about 1."""
MAX_COEFFICIENT = 1 << 16
"""A decoder refuses coefficients beyond."""


class Coefficient(NamedTuple):
    """How one number of a frame is written.

    Attributes:
        step: In its unit, at the usual quality.
        first: The place of the number that predicts it; -1 is none.
        is_signed: Whether it, less what predicts it, may be negative.
    """

    step: int
    table: Table
    first: int
    is_signed: bool


COEFFICIENTS = (
    *(
        Coefficient(step, LENGTH_TABLES[table], first, first >= 0)
        for step, table, first in zip(SHAPE_STEPS, SHAPE_TABLES, FIRST_SIDES, strict=True)
    ),
    *[Coefficient(ROTATION_STEP, LENGTH_TABLES[8], -1, True)] * 3,
    *[Coefficient(TRANSLATION_STEP, LENGTH_TABLES[9], -1, True)] * 3,
    *[Coefficient(REST_STEP, LENGTH_TABLES[REST_TABLE], -1, True)] * NUM_LATENT,
)
"""Of the 52 shapes, of rotation and translation, and of the rest of the latent."""
NUM_DRIVEN = len(COEFFICIENTS) - NUM_LATENT
"""Coefficients of a frame without a rest."""
PLACES = {
    HAS_FACE: range(NUM_ARKIT),
    HAS_POSE: range(NUM_ARKIT, NUM_DRIVEN),
    HAS_REST: range(NUM_DRIVEN, len(COEFFICIENTS)),
}
USUAL_STEPS = np.array([each.step for each in COEFFICIENTS])


@cache
def steps_of(quality: int) -> Int64Array:
    """The step of each coefficient, ``[314]``, in its unit."""
    steps: Int64Array = np.maximum(USUAL_STEPS * FINENESS[quality] // 16, 1)
    steps.flags.writeable = False
    return steps


def quantise(wanted: Int64Array, quality: int) -> list[int]:
    """Coefficients in steps, rounded to the nearest, or by one nearer to what predicts them where
    the bits are worth the error (`BIT_PRICE`; poses keep the nearest); none of a rest of zeros."""
    if not wanted[NUM_DRIVEN:].any():
        wanted = wanted[:NUM_DRIVEN]
    numbers: list[int] = []
    for value, step, how in zip(
        wanted.tolist(), steps_of(quality).tolist(), COEFFICIENTS, strict=False
    ):
        nearest = (2 * value + step) // (2 * step)
        ahead = nearest - (numbers[how.first] if how.first >= 0 else 0)
        if ahead and len(numbers) < NUM_ARKIT:
            towards = 1 if ahead > 0 else -1
            # The error grows from e to 1 - e, or to 1 + e on the other side: squared by 1 -+ 2 e.
            grown = 1 + 2 * towards * (value / step - nearest)
            if BIT_PRICE * (_bits(how, ahead) - _bits(how, ahead - towards)) > grown:
                nearest -= towards
        numbers.append(nearest)
    return numbers


def _bits(how: Coefficient, ahead: int) -> float:
    """What a number costs that is so far ahead of what predicts it."""
    length = abs(ahead).bit_length()
    uncoded = length - 1 + how.is_signed if length else 0
    return uncoded - math.log2(how.table.ranges[length][1] / TOTAL)


def encode_frame(numbers: list[int], quality: int, *, is_still: bool = False) -> bytes:
    """Write one frame.

    Args:
        numbers: Coefficients in steps, 58 or 314, within `MAX_COEFFICIENT` when multiplied by
            them, those of shapes at least 0.
        quality: Index of `FINENESS`.
        is_still: Whether the sender falls silent after it.
    """
    parts = [part for part, places in PLACES.items() if any(numbers[places.start : places.stop])]
    ranges = [QUALITY_TABLE.ranges[quality], HEADER_TABLE.ranges[sum(parts) + IS_STILL * is_still]]
    for place in (place for part in parts for place in PLACES[part]):
        how = COEFFICIENTS[place]
        ahead = numbers[place] - (numbers[how.first] if how.first >= 0 else 0)
        length = abs(ahead).bit_length()
        ranges.append(how.table.ranges[length])
        if length:
            if how.is_signed:
                ranges.append(uniform(ahead < 0, 1))
            ranges.append(uniform(abs(ahead) - (1 << (length - 1)), length - 1))
    return write_symbols(ranges)


def decode_frame(payload: bytes) -> tuple[Int64Array, bool]:
    """Read one frame.

    Returns:
        Its coefficients, ``[58]``, or ``[314]`` with the rest of a latent, and whether the sender
        falls silent after it.

    Raises:
        LatentError: The payload is none that an encoder writes.
    """
    reader = SymbolReader(payload)
    quality, header = reader.read(QUALITY_TABLE), reader.read(HEADER_TABLE)
    numbers = [0] * (len(COEFFICIENTS) if header & HAS_REST else NUM_DRIVEN)
    for place in (place for part, places in PLACES.items() if header & part for place in places):
        how = COEFFICIENTS[place]
        number = numbers[how.first] if how.first >= 0 else 0
        if length := reader.read(how.table):
            is_negative = how.is_signed and reader.read_uniform(1)
            magnitude = (1 << (length - 1)) + reader.read_uniform(length - 1)
            number += -magnitude if is_negative else magnitude
        numbers[place] = number
    reader.finish()
    coefficients = np.array(numbers, np.int64) * steps_of(quality)[: len(numbers)]
    if coefficients[:NUM_ARKIT].min() < 0:
        raise LatentError("a shape is negative")
    if np.abs(coefficients).max() > MAX_COEFFICIENT:
        raise LatentError(f"a coefficient is beyond the limit of {MAX_COEFFICIENT}")
    return coefficients, bool(header & IS_STILL)


class LatentEncoder:
    """The sending end of one stream.

    Args:
        avatar: Whose expression encoder predicts latents; needed for those of another encoder.
        fps: Frames a second that `encode` is called with; decides which may be left out.
        quality: Index of `FINENESS`; each step up costs about a sixth more bits.
    """

    def __init__(
        self, avatar: Avatar | None = None, *, fps: float = 30.0, quality: int = DEFAULT_QUALITY
    ) -> None:
        self._expressions = None if avatar is None else ExpressionEncoder(avatar)
        self._quality = quality
        self._multiples: tuple[int, ...] = (4, 1, 2, 1)
        if fps < 4 * LEAST_QUARTER_FPS:
            self._multiples = (4, 2) if fps >= 2 * LEAST_QUARTER_FPS else (4,)
        self.restart()

    def restart(self) -> None:
        """Send the next face, however still it is: no receiver has seen what was sent before."""
        self._sent: Int64Array | None = None
        self._sent_us = self._phase = 0
        self._quiet_since_us: int | None = None
        self._is_silent = False

    def encode(
        self,
        arkit: npt.ArrayLike,
        rotation: npt.ArrayLike,
        translation_m: npt.ArrayLike,
        now_us: int,
        *,
        latent: FloatArray | None = None,
    ) -> EncodedFrame | None:
        """Encode the next frame.

        Args:
            arkit: Values in `ARKIT_NAMES` order ``[52]``.
            rotation: Head pose, rotation vector, radians ``[3]``.
            translation_m: Offset from the seat, metres ``[3]``.
            now_us: Sender's clock, microseconds; never runs backwards.
            latent: The face, ``[8, 8, 4]``; by default what the avatar's expression encoder makes
                of `arkit`. One of another encoder takes five to ten times the bytes.

        Returns:
            The frame to send, or None: the face is still.

        Raises:
            ShapeError: An argument of another shape.
            LatentError: A value that is not finite, or a latent without an avatar.
        """
        wanted = self._coefficients(arkit, rotation, translation_m, latent)
        is_quiet = self._sent is not None and bool(
            (np.abs(wanted - self._sent) < USUAL_STEPS).all()
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
        payload = encode_frame(quantise(wanted, quality), quality, is_still=self._is_silent)
        self._sent, self._sent_us = wanted, now_us
        return EncodedFrame(payload, multiple)

    def _coefficients(
        self,
        arkit: npt.ArrayLike,
        rotation: npt.ArrayLike,
        translation_m: npt.ArrayLike,
        latent: FloatArray | None,
    ) -> Int64Array:
        values = np.asarray(arkit, np.float64)
        pose = np.array((rotation, translation_m), np.float64)
        rest: FloatArray = np.zeros(LATENT_SHAPE, np.float32)
        if values.shape != (NUM_ARKIT,) or pose.shape != (2, 3):
            raise ShapeError(
                f"arkit is {values.shape} and the pose {pose.shape}; "
                f"({NUM_ARKIT},) and (2, 3) are needed"
            )
        if latent is not None:
            if self._expressions is None:
                raise LatentError("a latent is given, but not the avatar that predicts it")
            if latent.shape != LATENT_SHAPE:
                raise ShapeError(f"latent is {latent.shape}; {LATENT_SHAPE} is needed")
            rest = latent - self._expressions.encode(values)
        if not all(np.isfinite(each).all() for each in (values, pose, rest)):
            raise LatentError("arkit, pose or latent holds a value that is not finite")
        units = np.clip(values, 0, MAX_SHAPE) / SHAPE_UNIT
        posed = np.clip(pose.reshape(-1), -MAX_POSE, MAX_POSE) / POSE_UNIT
        left = np.clip(rest.reshape(-1), -MAX_REST, MAX_REST) / REST_UNIT
        return np.rint(np.concatenate((units, posed, left))).astype(np.int64)


class LatentDecoder:
    """The receiving end of one stream; it keeps nothing between frames."""

    def __init__(self, avatar: Avatar) -> None:
        self._expressions = ExpressionEncoder(avatar)

    def decode(self, payload: bytes) -> LatentSample:
        """Decode a frame.

        Raises:
            LatentError: The payload is none that an encoder writes.
        """
        coefficients, is_still = decode_frame(payload)
        pose = (coefficients[NUM_ARKIT:NUM_DRIVEN] * POSE_UNIT).astype(np.float32)
        latent = self._expressions.encode(coefficients[:NUM_ARKIT] * SHAPE_UNIT)
        if len(coefficients) > NUM_DRIVEN:
            rest = coefficients[NUM_DRIVEN:].reshape(LATENT_SHAPE) * REST_UNIT
            latent += rest.astype(np.float32)
        if (length := np.linalg.norm(latent.astype(np.float64))) > MAX_LATENT_LENGTH:
            latent *= np.float32(MAX_LATENT_LENGTH / length)
        return LatentSample(
            latent=latent, rotation=pose[:3], translation_m=pose[3:], is_still=is_still
        )
