"""Whole streams of a face that rests: heartbeats, keyframes, and what comes after them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.stream_toy import (
    Publisher,
    Sent,
    assert_shown_is_true,
    deliver,
    deliver_all,
    perform,
    toy_faces,
    toy_pose,
    toy_profile,
)
from pica_core.codec.latent_stream import LatentDecoder, StreamConfig

pytestmark = pytest.mark.unit


def rest(publisher: Publisher, seconds: float, fps: float = 30) -> list[Sent]:
    """Show the last face of a short talk for so long."""
    publisher.show_all(toy_faces(1, 20), toy_pose(1, 20), fps=fps)
    count = round(seconds * fps)
    face, pose = toy_faces(1, 20)[-1:], toy_pose(1, 20)[-1:]
    return publisher.show_all(np.repeat(face, count, 0), np.repeat(pose, count, 0), fps=fps)


@pytest.mark.parametrize("fps", [15, 30, 90])
def test_a_still_face_falls_silent_but_for_a_heartbeat_a_second(fps: float) -> None:
    publisher = Publisher(StreamConfig(fps=fps))
    rest(publisher, 2, fps)
    begin = len(publisher.sent)
    publisher.show_all(
        np.repeat(toy_faces(1, 20)[-1:], round(30 * fps), 0),
        np.repeat(toy_pose(1, 20)[-1:], round(30 * fps), 0),
        fps=fps,
    )
    beats = publisher.sent[begin:]
    assert 28 <= len(beats) <= 33  # keyframes come in between and put the next beat off
    gaps_s = np.diff([frame.captured_us for frame in beats]) / 1e6
    assert gaps_s.max() <= 1.0 + 1.5 / fps
    shown = list(deliver_all(LatentDecoder(toy_profile()), publisher.sent))
    assert all(face.sample.is_still for face in shown[begin:])
    assert 8 * sum(len(frame.payload) for frame in beats) / 30 < 30


@settings(max_examples=60)
@given(seed=st.integers(0, 10_000), quality=st.integers(0, 7), layers=st.integers(1, 3))
def test_any_face_that_does_not_change_falls_silent(seed: int, quality: int, layers: int) -> None:
    publisher = Publisher(StreamConfig(quality=quality, num_layers=layers))
    poses = np.random.default_rng(seed).normal(0, 0.2, (1, 2, 3))
    publisher.show_all(toy_faces(seed, 9)[5:], toy_pose(seed, 4))
    publisher.show_all(np.repeat(toy_faces(seed, 1, 2.0), 24, 0), np.repeat(poses, 24, 0))
    begin = len(publisher.sent)
    publisher.show_all(np.repeat(toy_faces(seed, 1, 2.0), 60, 0), np.repeat(poses, 60, 0))
    assert len(publisher.sent) - begin <= 3
    # The pose of a head at rest is as good as its dead zone, and the rounding to whole units.
    steps = toy_profile().steps[quality]
    errors = poses.reshape(-1) * 2**14 - publisher.sent[-1].state.coefficients[-6:]
    assert (np.abs(errors) <= 0.67 * steps[-6:] + 0.5).all()


def test_the_last_frame_before_a_silence_is_finer_and_says_so() -> None:
    publisher = Publisher(StreamConfig(quality=3))
    sent = rest(publisher, 2)
    shown = list(deliver_all(LatentDecoder(toy_profile()), publisher.sent))[20:]
    first = next(i for i, face in enumerate(shown) if face.sample.is_still)
    assert sent[first].layer == 0
    assert sent[first].state.quality == 4
    assert 0.25 <= sent[first].captured_us / 1e6 - sent[0].captured_us / 1e6 <= 0.6


def test_a_face_that_moves_again_is_heard_at_once() -> None:
    publisher = Publisher()
    rest(publisher, 3.2)
    last_us = publisher.sent[-1].captured_us
    face = publisher.show(toy_faces(8, 5)[4] + 1, toy_pose(1, 20)[-1], last_us + 40_000)
    assert face is not None
    assert face.layer == 0
    after = publisher.show(toy_faces(8, 5)[4] + 1, toy_pose(1, 20)[-1], last_us + 73_000)
    assert after is not None
    shown = list(deliver_all(LatentDecoder(toy_profile()), publisher.sent))
    assert [each.sample.is_still for each in shown[-3:]] == [True, False, False]


def test_a_silent_face_answers_a_keyframe_request_and_stays_silent() -> None:
    publisher = Publisher()
    rest(publisher, 3)
    before = len(publisher.sent)
    publisher.encoder.request_keyframe()
    count = 15
    face, pose = toy_faces(1, 20)[-1:], toy_pose(1, 20)[-1:]
    publisher.show_all(np.repeat(face, count, 0), np.repeat(pose, count, 0))
    assert [frame.is_keyframe for frame in publisher.sent[before:]] == [True]
    (shown,) = deliver(LatentDecoder(toy_profile()), publisher.sent[-1])
    assert shown.sample.is_still


def test_a_face_that_only_trembles_within_the_dead_zone_is_still() -> None:
    publisher = Publisher()
    rng = np.random.default_rng(4)
    faces = toy_faces(1, 1) + rng.normal(0, 0.001, (300, 8, 8, 4))
    publisher.show_all(faces, np.zeros((300, 2, 3)))
    assert len(publisher.sent) < 30


def test_keyframe_requests_are_answered_together_after_a_pause() -> None:
    publisher = Publisher()
    faces, poses = toy_faces(1, 90), toy_pose(1, 90)
    for index in range(90):
        publisher.encoder.request_keyframe()
        publisher.show(faces[index], poses[index], round(index * 1e6 / 30))
    keys_s = [frame.captured_us / 1e6 for frame in publisher.sent if frame.is_keyframe]
    assert len(keys_s) in (11, 12)
    assert np.diff(keys_s).min() >= 0.25
    publisher = Publisher()
    publisher.show_all(faces[:15], poses[:15])
    publisher.encoder.request_keyframe()
    assert publisher.show_all(faces[15:], poses[15:])[0].is_keyframe


def test_a_keyframe_comes_by_itself_now_and_then() -> None:
    sent = perform(num_frames=400, config=StreamConfig(keyframe_interval_s=2))
    keys_s = [frame.captured_us / 1e6 for frame in sent if frame.is_keyframe]
    assert np.diff(keys_s).max() <= 2.04
    assert np.diff(keys_s).min() >= 1.99


def test_after_a_restart_a_keyframe_comes_first_even_within_the_pause() -> None:
    publisher = Publisher()
    publisher.show_all(toy_faces(1, 3), toy_pose(1, 3))
    publisher.encoder.restart()
    (first, *_) = publisher.show_all(toy_faces(1, 3), toy_pose(1, 3))
    assert first.is_keyframe


def test_a_head_that_leaps_from_one_side_to_the_other_is_sent_as_a_keyframe() -> None:
    publisher = Publisher(StreamConfig(quality=7))
    poses = np.array([[[3.1, 0, 0], [0, 0.99, 0]], [[-3.1, 0, 0], [0, -0.99, 0]]] * 6)
    publisher.show_all(toy_faces(1, 12), poses)
    shown = list(deliver_all(LatentDecoder(toy_profile()), publisher.sent))
    assert len(shown) == 12
    assert_shown_is_true(shown, publisher.sent)
    for face, pose in zip(shown, poses, strict=True):
        assert face.sample.rotation == pytest.approx(pose[0], abs=2e-3)
        assert face.sample.translation_m == pytest.approx(pose[1], abs=1e-3)
