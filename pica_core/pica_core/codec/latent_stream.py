"""The latent stream: faces in, a few bytes a frame out, and back. Every frame is decoded alone.

    encoder = LatentEncoder(profile, StreamConfig(fps=30))
    frame = encoder.encode(latent, rotation, translation_m, now_us)      # None: nothing to say
    sample = LatentDecoder(profile).decode(frame.payload)

A frame is quantised coefficients of the latent and of the head pose:

    coefficient = value / step, rounded to the nearest

A payload holds, in this order: the quality; what the frame holds (header); the coefficients of the
latent, then those of the pose. A part in which all are 0 is left out. Probabilities come from the
profile: each coefficient of the latent has a table by its place and by a context, which is how
large the coefficients just before it in the same frame are. Pose coefficients are written as their
length in bits, by a table of each, their sign and the rest. See docs/wire.md.

So any frame may be dropped by anybody, and a late joiner decodes the next one. A receiver that
wants less gets the frames whose sequence number is a multiple of 2 or 4; `EncodedFrame.multiple`
sees to it that what everybody must get is among them. A face that does not change falls silent: one
last, finer frame says so, then a heartbeat four times a second keeps the stream alive, until
something moves by more than a tracker's noise.

All is integers. Nothing here knows of time or networks; `now_us` is an argument.
"""

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pica_core.codec.profile import (
    ACTIVITY_LEVELS,
    ACTIVITY_WINDOW,
    ESCAPE,
    MAX_COEFFICIENT,
    NUM_LENGTHS,
    POSE_UNIT,
    StreamProfile,
)
from pica_core.codec.range_coder import Range, SymbolReader, Table, uniform, write_symbols
from pica_core.errors import LatentError, ShapeError, check_ranges
from pica_core.latent import LATENT_SHAPE, NUM_LATENT
from pica_core.types import Array, FloatArray, Int64Array


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


@dataclass(frozen=True, slots=True, eq=False)
class DecodedFrame:
    """A face with its place in the stream's time; fields as in `ReceivedFrame`."""

    number: int
    captured_us: int
    sample: LatentSample
    media_s: float = 0.0
    arrived_s: float = 0.0
    """When it came, on the receiver's clock, seconds."""


@dataclass(frozen=True, slots=True)
class ReceivedFrame:
    """A frame off the wire with its place in the stream's time, still to be decoded."""

    number: int
    """Counts the frames of the stream and never wraps; it leaps where the sender began again."""
    captured_us: int
    """Sender's clock as it was told, microseconds."""
    payload: bytes
    media_s: float = 0.0
    """Capture time on the stream's own time line, seconds: the sender's clock, from an origin of
    the receiver's, with its jumps taken out."""
    arrived_s: float = 0.0
    """When it came, on the receiver's clock, seconds."""

    def decoded(self, sample: LatentSample) -> DecodedFrame:
        """The frame with its face."""
        return DecodedFrame(self.number, self.captured_us, sample, self.media_s, self.arrived_s)


HAS_LATENT, HAS_POSE, IS_STILL = 1, 2, 4
REST_LENGTH_BITS = 4
"""What lies beyond an escape is written as its length in bits, so many, and then itself."""
MAX_REST_BITS = 13
LEAST_QUARTER_FPS = 5.0
"""What is left of a stream by the quarter of its sequence numbers, at least: less is a slide show.
Slower streams leave numbers out."""
MOVED_FACE, MOVED_POSE = 18, (8, 8, 8, 2, 2, 2)
"""How far a coefficient must move, in its units, for a face not to be still: a quarter of a root of
rendered MSE, half a milliradian, an eighth of a millimetre (chosen: below is what trackers do by
themselves)."""
DEFAULT_QUALITY = 3
STILL_AFTER_US = 250_000
"""A face that has not changed for so long falls silent."""
HEARTBEAT_US = 250_000
"""Time between two frames of a silent face."""
MAX_POSE = np.repeat((np.pi, 1.0), 3)
"""Rotation vectors (radians) and offsets (metres) are clamped to this: half a turn, an arm's length
about the chair."""


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamConfig:
    """How a stream is encoded."""

    fps: float = 30.0
    """Frames a second that `encode` is called with; decides which may be left out."""
    quality: int = DEFAULT_QUALITY
    """0 is the coarsest; each step up costs about a quarter more bits."""

    def __post_init__(self) -> None:
        check_ranges(self, fps=(0.1, 1000), quality=(0, 15))

    @property
    def multiples(self) -> tuple[int, ...]:
        """`EncodedFrame.multiple` of successive frames."""
        if self.fps < 2 * LEAST_QUARTER_FPS:
            return (4,)
        return (4, 2) if self.fps < 4 * LEAST_QUARTER_FPS else (4, 1, 2, 1)


def quantise(values: Int64Array, steps: Array) -> Int64Array:
    """Values in steps, rounded to the nearest. A dead zone about the mean face would save 5 % of
    the bits and hold lips back: 0.33 mm off instead of 0.30 (Amara, the real recording)."""
    magnitudes = (2 * np.abs(values) + steps) // (2 * steps)
    return np.where(values < 0, -magnitudes, magnitudes)


def encode_frame(
    profile: StreamProfile, quantised: Int64Array, quality: int, *, is_still: bool = False
) -> bytes:
    """Write one frame.

    Args:
        quantised: Coefficients in steps, ``[C]``.
        quality: Row of the profile's steps.
        is_still: Whether the sender falls silent after it.

    Raises:
        LatentError: A coefficient is beyond what a frame can hold.
    """
    values: list[int] = quantised.tolist()
    face, pose = values[: profile.num_components], values[profile.num_components :]
    header = HAS_LATENT * any(face) + HAS_POSE * any(pose) + IS_STILL * is_still
    qualities, headers, lengths = profile.frame_tables
    ranges = [qualities.ranges[quality], headers.ranges[header]]
    if header & HAS_LATENT:
        _write_face(ranges, face, profile.residual_tables)
    if header & HAS_POSE:
        for value, table in zip(pose, lengths, strict=True):
            length = abs(value).bit_length()
            if length >= NUM_LENGTHS:
                raise LatentError(f"a pose of {value} steps is beyond what a frame can hold")
            ranges.append(table.ranges[length])
            if length:
                ranges.append(uniform(value < 0, 1))
                _write_bits(ranges, abs(value) - (1 << (length - 1)), length - 1)
    return write_symbols(ranges)


def decode_frame(profile: StreamProfile, payload: bytes) -> tuple[Int64Array, bool]:
    """Read one frame.

    Returns:
        Its coefficients, ``[C]``, and whether the sender falls silent after it.

    Raises:
        LatentError: The payload is no frame of this profile.
    """
    reader = SymbolReader(payload)
    qualities, headers, lengths = profile.frame_tables
    quality, header = reader.read(qualities), reader.read(headers)
    values = [0] * profile.num_coefficients
    if header & HAS_LATENT:
        _read_face(reader, values, profile.residual_tables)
    if header & HAS_POSE:
        for place, table in enumerate(lengths, profile.num_components):
            if length := reader.read(table):
                is_negative = reader.read_uniform(1)
                magnitude = (1 << (length - 1)) + _read_bits(reader, length - 1)
                values[place] = -magnitude if is_negative else magnitude
    reader.finish()
    coefficients = np.array(values, np.int64) * profile.steps[quality]
    if np.abs(coefficients).max() > MAX_COEFFICIENT:
        raise LatentError(f"a coefficient is beyond the limit of {MAX_COEFFICIENT}")
    return coefficients, bool(header & IS_STILL)


def _write_face(
    ranges: list[Range], values: list[int], tables: tuple[tuple[Table, ...], ...]
) -> None:
    activity = 0
    for place, value in enumerate(values):
        magnitude = abs(value)
        shown = min(magnitude, ESCAPE)
        table = tables[place][bisect_right(ACTIVITY_LEVELS, activity)]
        ranges.append(table.ranges[2 * shown - (value > 0)])
        if magnitude >= ESCAPE:
            rest = magnitude - ESCAPE + 1
            length = rest.bit_length() - 1
            if length > MAX_REST_BITS:
                raise LatentError(f"a coefficient of {value} steps is beyond what a frame can hold")
            ranges.append(uniform(length, REST_LENGTH_BITS))
            ranges.append(uniform(rest - (1 << length), length))
        activity += magnitude
        if place >= ACTIVITY_WINDOW:
            activity -= abs(values[place - ACTIVITY_WINDOW])


def _read_face(
    reader: SymbolReader, values: list[int], tables: tuple[tuple[Table, ...], ...]
) -> None:
    activity = 0
    for place, contexts in enumerate(tables):
        symbol = reader.read(contexts[bisect_right(ACTIVITY_LEVELS, activity)])
        if symbol:
            magnitude = (symbol + 1) >> 1
            if magnitude >= ESCAPE:
                length = reader.read_uniform(REST_LENGTH_BITS)
                if length > MAX_REST_BITS:
                    raise LatentError(f"a rest of {length} bits; the limit is {MAX_REST_BITS}")
                magnitude += (1 << length) + reader.read_uniform(length) - 1
            values[place] = magnitude if symbol & 1 else -magnitude
            activity += magnitude
        if place >= ACTIVITY_WINDOW:
            activity -= abs(values[place - ACTIVITY_WINDOW])


def _write_bits(ranges: list[Range], value: int, count: int) -> None:
    """Write a number of up to 24 bits, the upper ones first."""
    low = min(count, 12)
    ranges += [uniform(value >> low, count - low), uniform(value & ((1 << low) - 1), low)]


def _read_bits(reader: SymbolReader, count: int) -> int:
    low = min(count, 12)
    return reader.read_uniform(count - low) << low | reader.read_uniform(low)


class LatentEncoder:
    """The sending end of one stream."""

    def __init__(self, profile: StreamProfile, config: StreamConfig | None = None) -> None:
        """Begin a stream.

        Raises:
            LatentError: A quality that the profile does not have.
        """
        self.profile = profile
        self.config = config or StreamConfig()
        highest = profile.num_qualities - 1
        if self.config.quality > highest:
            raise LatentError(f"quality is {self.config.quality}; this avatar has 0 to {highest}")
        self._multiples = self.config.multiples
        finest = min(self.config.quality + 1, highest)
        least_step = int(profile.steps[finest, : profile.num_components].min())
        # Far from the limit of what is decoded: rounding must not step over it.
        largest = (ESCAPE + (1 << MAX_REST_BITS)) * least_step
        self._largest_face = min(MAX_COEFFICIENT // 2, largest)
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
        quality = min(self.config.quality + self._is_silent, self.profile.num_qualities - 1)
        steps = self.profile.steps[quality]
        quantised = quantise(wanted, steps)
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
        np.clip(face, -self._largest_face, self._largest_face, out=face)
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
        return LatentSample(
            latent=self.profile.synthesise(coefficients[:count]).reshape(LATENT_SHAPE),
            rotation=pose[:3],
            translation_m=pose[3:],
            is_still=is_still,
        )
