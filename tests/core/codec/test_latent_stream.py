"""A latent stream: every frame alone, exact, bounded, silent while nothing moves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.stream_toy import STILL, Publisher, toy_faces
from helpers.toy import make_toy_avatar
from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.codec.latent_stream import (
    DEFAULT_QUALITY,
    FIRST_SIDES,
    HEARTBEAT_US,
    MAX_COEFFICIENT,
    NUM_DRIVEN,
    REST_STEP,
    REST_UNIT,
    SHAPE_UNIT,
    STILL_AFTER_US,
    LatentDecoder,
    LatentEncoder,
    decode_frame,
    encode_frame,
    quantise,
    steps_of,
)
from pica_core.errors import LatentError, ShapeError
from pica_core.types import LATENT_SHAPE, NUM_LATENT, Float64Array

pytestmark = pytest.mark.unit

FRAME_US = 33_333
NO_POSE = np.zeros((2, 3))


def rested(face: Float64Array, num_frames: int, quality: int = DEFAULT_QUALITY) -> Publisher:
    """An encoder that was shown one face for a while."""
    publisher = Publisher(quality=quality)
    for index in range(num_frames):
        publisher.show(face, NO_POSE, index * FRAME_US)
    return publisher


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    quality=st.integers(0, 7),
    reach=st.sampled_from([0, 1, 15, 30, 3000]),
    is_still=st.booleans(),
    has_rest=st.booleans(),
)
def test_any_coefficients_come_back_as_they_were(
    seed: int, quality: int, reach: int, is_still: bool, has_rest: bool
) -> None:
    steps = steps_of(quality)[: None if has_rest and reach else NUM_DRIVEN]
    values = np.random.default_rng(seed).integers(-reach, reach + 1, len(steps))
    values[:NUM_ARKIT] = np.abs(values[:NUM_ARKIT])
    numbers = np.clip(values, -MAX_COEFFICIENT // steps + 1, MAX_COEFFICIENT // steps)
    payload = encode_frame(numbers.tolist(), quality, is_still=is_still)
    coefficients, was_still = decode_frame(payload)
    np.testing.assert_array_equal(coefficients, numbers * steps)
    assert was_still == is_still


def test_a_pose_reaches_half_a_turn_and_a_metre_at_every_quality() -> None:
    far = np.array([[np.pi, -np.pi, 9.0], [1.0, -1.0, 0.0]])
    for quality in range(8):
        sent = Publisher(quality=quality).show(toy_faces(1, 1)[0], far, 0)
        assert sent is not None
        sample = sent.decoded()
        assert sample.rotation == pytest.approx([np.pi, -np.pi, np.pi], abs=1e-3)
        assert sample.translation_m == pytest.approx([1.0, -1.0, 0.0], abs=2e-4)


def test_a_still_face_falls_silent_with_a_heartbeat() -> None:
    publisher = rested(toy_faces(1, 1)[0], 100)
    still = [f for f in publisher.sent if f.decoded().is_still]
    quiet_frames = STILL_AFTER_US // FRAME_US
    assert len(publisher.sent) < quiet_frames + 18
    assert not any(frame.number % 4 for frame in still)
    gaps = np.diff([frame.captured_us for frame in still])
    assert np.all(np.abs(gaps - HEARTBEAT_US) < 2 * FRAME_US)


def test_a_still_frame_is_one_quality_finer() -> None:
    publisher = rested(toy_faces(1, 60)[20], 60, quality=0)
    coefficients, is_still = decode_frame(publisher.sent[-1].payload)
    assert is_still
    assert not np.any(coefficients % steps_of(1)[:NUM_DRIVEN])
    assert np.any(coefficients % steps_of(0)[:NUM_DRIVEN])


def test_a_movement_ends_the_silence_at_once_and_for_everybody() -> None:
    face = toy_faces(1, 60)[0]
    publisher = rested(face, 60)
    moved = publisher.show(face + 0.2, NO_POSE, 60 * FRAME_US)
    assert moved is not None
    assert moved.number % 4 == 0
    assert not moved.decoded().is_still


def test_a_restart_sends_a_still_face_again() -> None:
    face = toy_faces(1, 1)[0]
    publisher = rested(face, 61)
    assert publisher.show(face, NO_POSE, 61 * FRAME_US) is None
    publisher.encoder.restart()
    again = publisher.show(face, NO_POSE, 62 * FRAME_US)
    assert again is not None
    assert again.number % 4 == 0


def test_noise_below_the_dead_zone_does_not_keep_a_face_awake() -> None:
    rng, publisher, face = np.random.default_rng(0), Publisher(), toy_faces(1, 1)[0]
    for index in range(300):
        publisher.show(face + rng.normal(0, 0.0005, face.shape), NO_POSE, index * FRAME_US)
    assert len(publisher.sent) < 60


def test_faces_far_beyond_the_model_are_clamped_not_refused() -> None:
    for quality in (0, 7):
        sent = Publisher(quality=quality).show(np.full(NUM_ARKIT, 1e6), NO_POSE, 0)
        assert sent is not None
        assert np.linalg.norm(sent.decoded().latent) <= 128.1


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_value_that_is_not_finite_is_refused(value: float) -> None:
    encoder = LatentEncoder()
    with pytest.raises(LatentError, match="not finite"):
        encoder.encode(np.full(NUM_ARKIT, value), STILL, STILL, 0)
    with pytest.raises(LatentError, match="not finite"):
        encoder.encode(np.zeros(NUM_ARKIT), [value, 0, 0], STILL, 0)


def test_another_shape_is_refused_by_name() -> None:
    encoder = LatentEncoder()
    with pytest.raises(ShapeError, match=r"arkit is \(51,\)"):
        encoder.encode(np.zeros(51), STILL, STILL, 0)


def test_a_sender_saves_bytes_and_stays_within_a_step() -> None:
    steps, sizes = steps_of(DEFAULT_QUALITY)[:NUM_DRIVEN], np.zeros(2)
    for face in toy_faces(5, 300):
        exact = np.append(np.rint(face / SHAPE_UNIT), np.zeros(6 + NUM_LATENT)).astype(np.int64)
        nearest = np.rint(exact[:NUM_DRIVEN] / steps).astype(int).tolist()
        spared = quantise(exact, DEFAULT_QUALITY)
        assert (np.abs(spared * steps - exact[:NUM_DRIVEN]) < steps).all()
        sizes += [len(encode_frame(numbers, DEFAULT_QUALITY)) for numbers in (nearest, spared)]
    assert sizes[1] < 0.98 * sizes[0]


def test_a_face_that_is_alike_on_both_sides_costs_little_more_than_one_side() -> None:
    left = np.zeros(NUM_DRIVEN, int)
    left[[first for first in FIRST_SIDES if first >= 0]] = 5
    both = left.copy()
    both[:NUM_ARKIT] = [
        5 if first >= 0 else value for value, first in zip(left, FIRST_SIDES, strict=False)
    ]
    sizes = [len(encode_frame(each.tolist(), DEFAULT_QUALITY)) for each in (left, both)]
    assert sizes[1] < 0.8 * sizes[0]


def test_a_second_side_below_none_is_refused() -> None:
    below = [0] * NUM_DRIVEN
    below[FIRST_SIDES.index(0)] = -1  # less than a first side that is 0
    with pytest.raises(LatentError, match="negative"):
        decode_frame(encode_frame(below, DEFAULT_QUALITY))


def test_a_latent_of_another_encoder_arrives_within_half_a_step() -> None:
    avatar, rng = make_toy_avatar(), np.random.default_rng(1)
    encoder, decoder = LatentEncoder(avatar), LatentDecoder(avatar)
    driven, arkit = ExpressionEncoder(avatar), toy_faces(1, 1)[0]
    own = encoder.encode(arkit, STILL, STILL, 0, latent=driven.encode(arkit))
    plain = LatentEncoder().encode(arkit, STILL, STILL, 0)
    assert own == plain, "of a latent that the values make nothing is left"
    for number in range(1, 20):
        latent = rng.normal(0, 0.5, LATENT_SHAPE).astype(np.float32)
        sent = encoder.encode(np.zeros(NUM_ARKIT), STILL, STILL, number * FRAME_US, latent=latent)
        assert sent is not None
        got = decoder.decode(sent.payload).latent
        assert np.abs(got - latent).max() <= 0.52 * REST_STEP * REST_UNIT
        assert len(sent.payload) < 256
    with pytest.raises(LatentError, match="not the avatar"):
        LatentEncoder().encode(arkit, STILL, STILL, 0, latent=latent)
    with pytest.raises(ShapeError, match=r"latent is \(4, 4, 4\)"):
        encoder.encode(arkit, STILL, STILL, 10**6, latent=np.zeros((4, 4, 4), np.float32))
