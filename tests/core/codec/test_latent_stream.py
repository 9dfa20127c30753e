"""A latent stream: every frame alone, exact, bounded, silent while nothing moves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.stream_toy import (
    STILL,
    Publisher,
    toy_faces,
    toy_profile,
)
from pica_core.codec.latent_stream import (
    DEFAULT_QUALITY,
    HEARTBEAT_US,
    MAX_COEFFICIENT,
    STILL_AFTER_US,
    LatentEncoder,
    decode_frame,
    encode_frame,
    quantise,
    spare_bits,
    steps_of,
)
from pica_core.codec.profile import NUM_POSE
from pica_core.errors import LatentError, ShapeError
from pica_core.types import Float64Array

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
)
def test_any_coefficients_come_back_as_they_were(
    seed: int, quality: int, reach: int, is_still: bool
) -> None:
    profile = toy_profile()
    steps = steps_of(quality, profile.num_components)
    largest = MAX_COEFFICIENT // steps
    values = np.random.default_rng(seed).integers(-reach, reach + 1, profile.num_coefficients)
    values = np.clip(values, -largest, largest)
    payload = encode_frame(profile, values, quality, is_still=is_still)
    coefficients, was_still = decode_frame(profile, payload)
    np.testing.assert_array_equal(coefficients, values * steps)
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
    coefficients, is_still = decode_frame(toy_profile(), publisher.sent[-1].payload)
    assert is_still
    assert not np.any(coefficients % steps_of(1, toy_profile().num_components))
    assert np.any(coefficients % steps_of(0, toy_profile().num_components))


def test_a_movement_ends_the_silence_at_once_and_for_everybody() -> None:
    face = toy_faces(1, 60)[0]
    publisher = rested(face, 60)
    moved = publisher.show(face + 2.0, NO_POSE, 60 * FRAME_US)
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
        publisher.show(face + rng.normal(0, 0.005, face.shape), NO_POSE, index * FRAME_US)
    assert len(publisher.sent) < 60


def test_faces_far_beyond_the_model_are_clamped_not_refused() -> None:
    for quality in (0, 7):
        sent = Publisher(quality=quality).show(np.full((8, 8, 4), 1e6), NO_POSE, 0)
        assert sent is not None
        assert np.linalg.norm(sent.decoded().latent) <= 128.1


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_value_that_is_not_finite_is_refused(value: float) -> None:
    encoder = LatentEncoder(toy_profile())
    with pytest.raises(LatentError, match="not finite"):
        encoder.encode(np.full((8, 8, 4), value), STILL, STILL, 0)
    with pytest.raises(LatentError, match="not finite"):
        encoder.encode(np.zeros((8, 8, 4)), [value, 0, 0], STILL, 0)


def test_another_shape_is_refused_by_name() -> None:
    encoder = LatentEncoder(toy_profile())
    with pytest.raises(ShapeError, match=r"latent is \(256,\)"):
        encoder.encode(np.zeros(256), STILL, STILL, 0)


def test_a_sender_saves_bytes_and_stays_within_a_step() -> None:
    profile = toy_profile()
    steps = steps_of(DEFAULT_QUALITY, profile.num_components)
    sizes = np.zeros(2)
    for face in toy_faces(5, 300):
        exact = np.append(profile.analyse(face.reshape(-1)), np.zeros(NUM_POSE, np.int64))
        nearest = quantise(exact, steps)
        spared = nearest.copy()
        spare_bits(profile, exact[:-NUM_POSE], spared, int(steps[0]))
        assert (np.abs(spared * steps - exact) < steps).all()
        sizes += [len(encode_frame(profile, q, DEFAULT_QUALITY)) for q in (nearest, spared)]
    assert sizes[1] < 0.98 * sizes[0]
