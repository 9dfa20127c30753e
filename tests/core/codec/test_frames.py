"""One frame to bytes and back: both ends know the same, and no bytes make a receiver know
nonsense."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.stream_toy import toy_profile
from pica_core.codec.frames import (
    MAX_RESIDUAL,
    FrameState,
    decode_frame,
    encode_frame,
    frame_type,
    predict,
    quantise,
)
from pica_core.codec.profile import MAX_COEFFICIENT
from pica_core.codec.range_coder import uniform, write_symbols
from pica_core.errors import LatentError, MissingReferenceError

pytestmark = pytest.mark.unit

PROFILE = toy_profile()
COUNT = PROFILE.num_coefficients
ZERO = np.zeros(COUNT, np.int64)
RESIDUALS = st.lists(
    st.one_of(
        st.just(0), st.integers(-2, 2), st.integers(-30, 30), st.sampled_from([-150, 11, 12, 13])
    ),
    min_size=COUNT,
    max_size=COUNT,
)


def frame(
    residuals: list[int] | np.ndarray[Any, Any],
    reference: FrameState | None = None,
    *,
    sequence: int = 0,
    layer: int = 0,
    quality: int = 3,
    is_still: bool = False,
) -> tuple[bytes, FrameState]:
    return encode_frame(
        PROFILE,
        np.asarray(residuals, np.int64),
        sequence=sequence,
        layer=layer,
        quality=quality,
        reference=reference,
        is_still=is_still,
    )


def decode(
    payload: bytes, *references: FrameState, sequence: int = 0, layer: int = 0
) -> tuple[FrameState, bool]:
    return decode_frame(
        PROFILE,
        payload,
        sequence=sequence,
        layer=layer,
        is_keyframe=not references,
        references={reference.sequence: reference for reference in references},
    )


def assert_same(one: FrameState, other: FrameState) -> None:
    np.testing.assert_array_equal(one.coefficients, other.coefficients)
    np.testing.assert_array_equal(one.motion, other.motion)
    assert (one.sequence, one.layer, one.quality) == (other.sequence, other.layer, other.quality)


@settings(max_examples=100)
@given(data=st.data())
def test_the_decoder_goes_on_with_exactly_what_the_encoder_does(data: st.DataObject) -> None:
    quality, is_still = data.draw(st.integers(0, 7)), data.draw(st.booleans())
    payload, key = frame(data.draw(RESIDUALS), quality=quality, is_still=is_still)
    state, was_still = decode(payload)
    assert_same(state, key)
    assert was_still == is_still
    reference, number = key, 0
    for _ in range(3):
        layer = data.draw(st.integers(reference.layer + (reference.layer > 0), 2))
        distance = data.draw(st.integers(1, 16))
        number = reference.sequence + distance
        payload, sent = frame(
            data.draw(RESIDUALS),
            reference,
            sequence=number,
            layer=layer,
            quality=data.draw(st.integers(0, 7)),
        )
        state, _ = decode(payload, reference, sequence=number, layer=layer)
        assert_same(state, sent)
        if layer < 2:
            reference = sent


@pytest.mark.parametrize("value", [MAX_RESIDUAL, -MAX_RESIDUAL, 12, -12, 11])
def test_the_largest_residuals_come_through(value: int) -> None:
    residuals = ZERO.copy()
    residuals[[0, -1]] = value
    _, key = frame(ZERO)
    fine = FrameState(0, 0, 7, key.coefficients * 0, key.motion)
    residuals[0] = min(max(value, -8000), 8000)  # 8000 steps of 8 are what the limit allows
    residuals[-1] = min(max(value, -MAX_COEFFICIENT // 4), MAX_COEFFICIENT // 4)
    payload, sent = frame(residuals, fine, sequence=1, quality=7)
    assert_same(decode(payload, fine, sequence=1)[0], sent)


def test_a_residual_beyond_what_can_be_said_is_refused() -> None:
    residuals = ZERO.copy()
    residuals[-1] = MAX_RESIDUAL + 1
    with pytest.raises(LatentError, match=f"residual of {MAX_RESIDUAL + 1} steps"):
        frame(residuals, quality=7)


def test_a_coefficient_beyond_the_limit_is_refused_by_both_ends() -> None:
    residuals = ZERO.copy()
    residuals[0] = 700
    _, state = frame(residuals, quality=0)
    with pytest.raises(LatentError, match="beyond the limit of 65536"):
        frame(residuals, state, sequence=1, quality=0)
    # The same bytes against a reference that is not so far out are a frame.
    payload, _ = frame(residuals, FrameState(0, 0, 0, ZERO, ZERO), sequence=1, quality=0)
    still = FrameState(0, 0, 0, state.coefficients, ZERO)
    with pytest.raises(LatentError, match="beyond the limit of 65536"):
        decode(payload, still, sequence=1)


@pytest.mark.parametrize(
    ("layer", "reference_layer", "kind"),
    [(0, None, 0), (0, 0, 1), (1, 0, 2), (2, 0, 3), (2, 1, 4)],
)
def test_a_frame_type_follows_from_layer_and_reference(
    layer: int, reference_layer: int | None, kind: int
) -> None:
    reference = None if reference_layer is None else FrameState(0, reference_layer, 0, ZERO, ZERO)
    assert frame_type(layer, reference) == kind


@pytest.mark.parametrize(
    ("layer", "reference_layer"),
    [(0, 1), (0, 2), (1, 1), (1, 2), (2, 2), (1, None), (2, None), (3, 0), (3, None), (-1, None)],
)
def test_no_frame_refers_to_a_higher_layer_or_its_own_upper_one(
    layer: int, reference_layer: int | None
) -> None:
    reference = None if reference_layer is None else FrameState(0, reference_layer, 0, ZERO, ZERO)
    with pytest.raises(LatentError, match="layer"):
        frame_type(layer, reference)
    with pytest.raises(LatentError, match="layer"):
        frame(ZERO, reference, sequence=1, layer=layer)


@pytest.mark.parametrize("layer", [-1, 3, 15])
def test_a_frame_of_a_layer_that_is_not_there_is_refused(layer: int) -> None:
    _, key = frame(ZERO)
    payload, _ = frame(ZERO, key, sequence=1)
    with pytest.raises(LatentError, match=f"layer is {layer}"):
        decode(payload, key, sequence=1, layer=layer)


@pytest.mark.parametrize("distance", [-1, 0, 17, 1000])
def test_a_reference_is_one_to_sixteen_frames_back(distance: int) -> None:
    _, key = frame(ZERO)
    with pytest.raises(LatentError, match=f"reference is {distance} frames back"):
        frame(ZERO, key, sequence=distance)


def test_a_reference_that_is_not_there_is_told_apart_from_damage() -> None:
    _, key = frame(ZERO)
    payload, _ = frame(ZERO, key, sequence=5)
    _, stranger = frame(ZERO, sequence=9)
    with pytest.raises(MissingReferenceError, match="the frame 5 before is not there"):
        decode(payload, stranger, sequence=5)


def test_a_keyframe_of_a_quality_that_the_profile_lacks_is_refused() -> None:
    payload = write_symbols([uniform(8, 4), PROFILE.header_ranges[0].ranges[0]])
    with pytest.raises(LatentError, match="quality is 8; this profile has 8"):
        decode(payload)


def test_parts_without_residuals_cost_nothing() -> None:
    neutral, key = frame(ZERO)
    resting, _ = frame(ZERO, key, sequence=4)
    nodding, _ = frame([0] * (COUNT - 1) + [3], key, sequence=4)
    talking, _ = frame([3] * COUNT, key, sequence=4)
    assert len(neutral) <= 2
    assert len(resting) <= 1
    assert len(resting) < len(nodding) < len(talking)


def test_a_head_goes_on_as_it_moved_and_a_face_stays() -> None:
    moved = np.full(COUNT, 64)
    reference = FrameState(0, 0, 3, np.full(COUNT, 1000), moved)
    expected = predict(PROFILE, 1, reference)
    np.testing.assert_array_equal(expected[: PROFILE.num_components], 1000)
    np.testing.assert_array_equal(expected[PROFILE.num_components :], 1054)  # gain 54 / 64
    np.testing.assert_array_equal(predict(PROFILE, 0, None), 0)


@settings(max_examples=100)
@given(value=st.integers(-100_000, 100_000), step=st.integers(1, 16384))
def test_quantising_leaves_at_most_the_dead_zone(value: int, step: int) -> None:
    steps = np.array([step])
    nearest = quantise(np.array([value]), steps, 32)
    assert abs(value - int(nearest[0]) * step) <= step / 2
    cut = quantise(np.array([value]), steps, 22)
    assert abs(value - int(cut[0]) * step) <= step * 42 / 64
    assert quantise(np.array([-value]), steps, 22)[0] == -cut[0]
