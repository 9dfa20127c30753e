"""One frame of a latent stream <-> payload bytes, given its reference.

Every frame but a keyframe predicts its coefficients from one earlier frame, its *reference*:

    prediction = reference + gain * motion of the reference     (gain by frame type; unit 1/64)
    residual   = round toward zero with a dead zone((value - prediction) / step)
    value      = prediction + residual * step                   (what both ends go on with)
    motion     = value - reference value

A payload holds, in this order: how many frames back the reference is (not in a keyframe), the
quality, what the frame holds (header), then the residuals of the latent, then those of the pose;
a part in which all residuals are 0 is left out. Probabilities come from the profile: each residual
has a table by frame type, coefficient and context, the context being how much this coefficient
moved in the reference and how large the residuals just before it are. See docs/bitstream.md.

All is integers. Nothing here knows of time, networks or which reference to choose: that is
`latent_stream`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pica_core.codec.profile import (
    ACTIVITY_LEVELS,
    ACTIVITY_WINDOW,
    ESCAPE,
    MAX_COEFFICIENT,
    MAX_DISTANCE,
    MOTION_LEVELS,
    NUM_LAYERS,
    StreamProfile,
)
from pica_core.codec.range_coder import Range, SymbolReader, Table, uniform, write_symbols
from pica_core.errors import LatentError, MissingReferenceError
from pica_core.types import Int64Array

HAS_LATENT, HAS_POSE, IS_STILL = 1, 2, 4
QUALITY_BITS = 4
"""A keyframe states its quality in so many bits."""
REST_LENGTH_BITS = 4
"""What lies beyond an escape is written as its length in bits, so many, and then itself."""
MAX_REST_BITS = 13
MAX_RESIDUAL = ESCAPE + (1 << (MAX_REST_BITS + 1)) - 2
"""Largest magnitude that an escape and its rest can say."""
DEAD_ZONE_BITS = 6

_ACTIVITY_LEVEL = bytes(
    sum(activity >= level for level in ACTIVITY_LEVELS)
    for activity in range(ACTIVITY_LEVELS[-1] + 1)
)
_MAX_ACTIVITY = len(_ACTIVITY_LEVEL) - 1
_NUM_ACTIVITY_LEVELS = len(ACTIVITY_LEVELS) + 1


@dataclass(frozen=True, slots=True, eq=False)
class FrameState:
    """A coded frame as both ends know it, and as later frames refer to it."""

    sequence: int
    """Counts the frames of the stream; never wraps here."""
    layer: int
    quality: int
    coefficients: Int64Array
    """Quantised coefficients of the latent, int64 ``[C]``."""
    motion: Int64Array
    """Less those of the frame's own reference; 0 for a keyframe. int64 ``[C]``."""


def frame_type(layer: int, reference: FrameState | None) -> int:
    """The row of the profile's tables for a frame.

    Raises:
        LatentError: The layer does not exist, or may not refer to that reference.
    """
    if not 0 <= layer < NUM_LAYERS:
        raise LatentError(f"layer is {layer}; allowed are 0 to {NUM_LAYERS - 1}")
    if reference is None:
        if layer != 0:
            raise LatentError(f"a keyframe of layer {layer}; keyframes are of layer 0")
        return 0
    if reference.layer > layer or (reference.layer == layer and layer > 0):
        raise LatentError(f"layer {layer} refers to layer {reference.layer}")
    return 1 + layer + (reference.layer == 1)


def predict(profile: StreamProfile, kind: int, reference: FrameState | None) -> Int64Array:
    """What a frame of a type is expected to be. int64 ``[C]``."""
    if reference is None:
        return np.zeros(profile.num_coefficients, np.int64)
    return reference.coefficients + ((profile.gains[kind] * reference.motion) >> 6)


def quantise(
    residual: Int64Array, steps: npt.NDArray[Any], rounding: int | Int64Array
) -> Int64Array:
    """Residuals in steps; `rounding` / 64 is added before cutting off, 32 is to the nearest."""
    magnitudes = ((np.abs(residual) << DEAD_ZONE_BITS) + rounding * steps) // (
        steps << DEAD_ZONE_BITS
    )
    return np.where(residual < 0, -magnitudes, magnitudes)


def motion_levels(
    profile: StreamProfile, quality: int, reference: FrameState | None
) -> npt.NDArray[np.int64]:
    """The part of the contexts that comes from the reference, per coefficient. int64 ``[C]``."""
    levels = np.zeros(profile.num_coefficients, np.int64)
    if reference is not None:
        doubled, steps = 2 * np.abs(reference.motion), profile.steps[quality]
        for level in MOTION_LEVELS:
            levels += doubled >= level * steps
    return levels


def encode_frame(
    profile: StreamProfile,
    quantised: Int64Array,
    *,
    sequence: int,
    layer: int,
    quality: int,
    reference: FrameState | None,
    is_still: bool = False,
) -> tuple[bytes, FrameState]:
    """Write one frame.

    Args:
        quantised: Residuals in steps, ``[C]``.
        sequence: Of this frame, above the reference's.
        layer: 0 to 2.
        quality: Row of the profile's steps.
        reference: An earlier frame of a lower layer (or of layer 0 for layer 0), at most
            `MAX_DISTANCE` back; None makes a keyframe.

    Raises:
        LatentError: A reference that the format does not allow, or values out of its range.
    """
    kind = frame_type(layer, reference)
    num_latent = profile.num_components
    values: list[int] = quantised.tolist()
    header = IS_STILL if is_still else 0
    ranges: list[Range] = []
    if reference is None:
        ranges.append(uniform(quality, QUALITY_BITS))
    else:
        distance = sequence - reference.sequence
        if not 1 <= distance <= MAX_DISTANCE:
            raise LatentError(f"reference is {distance} frames back; 1 to {MAX_DISTANCE} allowed")
        change = (quality - reference.quality) % profile.num_qualities
        ranges.append(profile.distance_ranges[layer].ranges[distance - 1])
        ranges.append(profile.quality_ranges.ranges[change])
    header |= HAS_LATENT if any(values[:num_latent]) else 0
    header |= HAS_POSE if any(values[num_latent:]) else 0
    ranges.append(profile.header_ranges[kind].ranges[header])
    if header & (HAS_LATENT | HAS_POSE):
        levels = motion_levels(profile, quality, reference).tolist()
        tables = profile.residual_tables[kind]
        if header & HAS_LATENT:
            _write_residuals(ranges, values, tables, levels, 0, num_latent)
        if header & HAS_POSE:
            _write_residuals(ranges, values, tables, levels, num_latent, len(values))
    state = next_state(profile, quantised, kind, sequence, layer, quality, reference)
    return write_symbols(ranges), state


def decode_frame(
    profile: StreamProfile,
    payload: bytes,
    *,
    sequence: int,
    layer: int,
    is_keyframe: bool,
    references: Mapping[int, FrameState],
) -> tuple[FrameState, bool]:
    """Read one frame.

    Args:
        payload: As `encode_frame` made it, or anything else.
        references: Frames decoded before, by sequence.

    Returns:
        The frame, and whether the sender falls silent after it.

    Raises:
        MissingReferenceError: The frame that this one refers to is not among `references`.
        LatentError: The payload is no frame of this profile.
    """
    reader = SymbolReader(payload)
    reference: FrameState | None = None
    if is_keyframe:
        kind = frame_type(layer, None)
        quality = reader.read_uniform(QUALITY_BITS)
        if quality >= profile.num_qualities:
            raise LatentError(f"quality is {quality}; this profile has {profile.num_qualities}")
    else:
        if not 0 <= layer < NUM_LAYERS:
            raise LatentError(f"layer is {layer}; allowed are 0 to {NUM_LAYERS - 1}")
        distance = 1 + reader.read(profile.distance_ranges[layer])
        reference = references.get(sequence - distance)
        if reference is None:
            raise MissingReferenceError(f"the frame {distance} before is not there")
        kind = frame_type(layer, reference)
        quality = (reference.quality + reader.read(profile.quality_ranges)) % profile.num_qualities
    header = reader.read(profile.header_ranges[kind])
    num_latent, num_values = profile.num_components, profile.num_coefficients
    values = [0] * num_values
    if header & (HAS_LATENT | HAS_POSE):
        levels = motion_levels(profile, quality, reference).tolist()
        tables = profile.residual_tables[kind]
        if header & HAS_LATENT:
            _read_residuals(reader, values, tables, levels, 0, num_latent)
        if header & HAS_POSE:
            _read_residuals(reader, values, tables, levels, num_latent, num_values)
    reader.finish()
    quantised = np.array(values, np.int64)
    state = next_state(profile, quantised, kind, sequence, layer, quality, reference)
    return state, bool(header & IS_STILL)


def next_state(
    profile: StreamProfile,
    quantised: Int64Array,
    kind: int,
    sequence: int,
    layer: int,
    quality: int,
    reference: FrameState | None,
) -> FrameState:
    """What both ends know after a frame.

    Raises:
        LatentError: A coefficient is beyond what a frame may hold.
    """
    values = predict(profile, kind, reference) + quantised * profile.steps[quality]
    if values.max() > MAX_COEFFICIENT or values.min() < -MAX_COEFFICIENT:
        raise LatentError(f"a coefficient is beyond the limit of {MAX_COEFFICIENT}")
    motion = values - reference.coefficients if reference is not None else np.zeros_like(values)
    return FrameState(sequence, layer, quality, values, motion)


def _write_residuals(
    ranges: list[Range],
    values: list[int],
    tables: tuple[tuple[Table, ...], ...],
    levels: list[int],
    begin: int,
    end: int,
) -> None:
    activity = 0
    for place in range(begin, end):
        value = values[place]
        magnitude = value if value >= 0 else -value
        context = (
            levels[place] * _NUM_ACTIVITY_LEVELS
            + _ACTIVITY_LEVEL[activity if activity < _MAX_ACTIVITY else _MAX_ACTIVITY]
        )
        shown = magnitude if magnitude < ESCAPE else ESCAPE
        symbol = 2 * shown - (value > 0)
        ranges.append(tables[place][context].ranges[symbol])
        if magnitude >= ESCAPE:
            rest = magnitude - ESCAPE + 1
            length = rest.bit_length() - 1
            if length > MAX_REST_BITS:
                raise LatentError(f"a residual of {value} steps is beyond what a frame can hold")
            ranges.append(uniform(length, REST_LENGTH_BITS))
            ranges.append(uniform(rest - (1 << length), length))
        activity += magnitude
        if place - begin >= ACTIVITY_WINDOW:
            old = values[place - ACTIVITY_WINDOW]
            activity -= old if old >= 0 else -old


def _read_residuals(
    reader: SymbolReader,
    values: list[int],
    tables: tuple[tuple[Table, ...], ...],
    levels: list[int],
    begin: int,
    end: int,
) -> None:
    activity = 0
    read = reader.read
    for place in range(begin, end):
        context = (
            levels[place] * _NUM_ACTIVITY_LEVELS
            + _ACTIVITY_LEVEL[activity if activity < _MAX_ACTIVITY else _MAX_ACTIVITY]
        )
        symbol = read(tables[place][context])
        if symbol:
            magnitude = (symbol + 1) >> 1
            if magnitude >= ESCAPE:
                length = reader.read_uniform(REST_LENGTH_BITS)
                if length > MAX_REST_BITS:
                    raise LatentError(f"a residual of {length} bits; the limit is {MAX_REST_BITS}")
                magnitude += (1 << length) + reader.read_uniform(length) - 1
            values[place] = magnitude if symbol & 1 else -magnitude
            activity += magnitude
        if place - begin >= ACTIVITY_WINDOW:
            old = values[place - ACTIVITY_WINDOW]
            activity -= old if old >= 0 else -old
