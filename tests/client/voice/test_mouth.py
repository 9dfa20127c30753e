"""The mouth that follows a voice: the network and the face that it fills in."""

from dataclasses import replace

import numpy as np
import pytest

from pica_client.sources.source import Source, Unseen, make_performance
from pica_client.voice.mouth import (
    HOP,
    MOUTH,
    NUM_BANDS,
    SEAM_S,
    SILENT_AFTER_S,
    MouthFromVoice,
    SpeechFeatures,
    SpokenFace,
)
from pica_client.voice.opus import SAMPLE_RATE_HZ
from pica_core.avatar.arkit import ARKIT_INDEX, ARKIT_NAMES, ExpressionFrame
from pica_core.types import FloatArray

pytestmark = pytest.mark.unit

FRAME = 960
JAW, PUCKER = ARKIT_INDEX["jawOpen"], ARKIT_INDEX["mouthPucker"]
VOWELS = {"ah": (730, 1090, 2440), "oo": (300, 870, 2240)}
"""Three formants in hertz: Peterson and Barney, JASA 24, 1952."""


def vowel(name: str, seconds: float, loudness: float = 0.3) -> FloatArray:
    """A hum of 120 Hz through three resonances."""
    time_s = np.arange(round(seconds * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    sound = np.zeros(len(time_s))
    for harmonic in range(1, 40):
        hz = 120 * harmonic
        gain = 1 / harmonic
        for formant in VOWELS[name]:  # resonances of 90 Hz in a row (Klatt, JASA 67, 1980)
            gain *= formant**2 / abs(formant**2 - hz**2 + 1j * hz * 90)
        sound += gain * np.sin(2 * np.pi * hz * time_s)
    return (loudness * sound / np.abs(sound).max()).astype(np.float32)


def silence(seconds: float) -> FloatArray:
    return np.zeros(round(seconds * SAMPLE_RATE_HZ), np.float32)


def test_sound_in_pieces_is_heard_as_in_one() -> None:
    sound = np.concatenate([vowel("ah", 0.2), silence(0.1), vowel("oo", 0.1)])
    whole = SpeechFeatures().push(sound)
    features, mouth = SpeechFeatures(), MouthFromVoice()
    pieces = np.concatenate([features.push(part) for part in sound.reshape(-1, FRAME)])
    assert whole.shape == (len(sound) // HOP, NUM_BANDS)
    np.testing.assert_allclose(pieces, whole, atol=1e-5)
    spoken = np.concatenate([mouth.push(part) for part in sound.reshape(-1, FRAME)])
    np.testing.assert_allclose(spoken, MouthFromVoice().push(sound), atol=1e-4)


def test_a_mouth_opens_for_ah_rounds_for_oo_and_rests_in_silence() -> None:
    mouth = MouthFromVoice()
    still = mouth.push(silence(0.5))
    ah = mouth.push(vowel("ah", 0.4))
    after = mouth.push(silence(0.8))
    oo = MouthFromVoice().push(vowel("oo", 0.4))
    assert still.max() < 0.1
    assert ah[20:, JAW].mean() > 0.25
    assert ah[20:, JAW].mean() > oo[20:, JAW].mean() + 0.05
    assert oo[20:, PUCKER].mean() > ah[20:, PUCKER].mean() + 0.02
    assert after[-10:].max() < 0.1
    assert not after[:, ~MOUTH].any()


@pytest.mark.parametrize("loudness", [0.02, 0.9])
def test_a_quiet_and_a_loud_voice_open_the_mouth_alike(loudness: float) -> None:
    usual = MouthFromVoice().push(vowel("ah", 0.6))[30:, JAW].mean()
    other = MouthFromVoice().push(vowel("ah", 0.6, loudness))[30:, JAW].mean()
    assert abs(other - usual) < 0.1


class Lossy:
    """A tracker that sees a smiling face but between two moments."""

    def __init__(self, begin_s: float, end_s: float) -> None:
        self._lost = begin_s, end_s
        self._face = make_performance("talk").frame_at(1.0)

    def frame_at(self, time_s: float) -> ExpressionFrame:
        has_face = not self._lost[0] <= time_s < self._lost[1]
        return replace(self._face, captured_us=round((time_s - 0.02) * 1e6), has_face=has_face)


def play(source: Source, seconds: float, *, talk_until_s: float) -> list[ExpressionFrame]:
    """A hundred faces a second, with a voice that sings until some moment."""
    face = SpokenFace()
    voice = np.concatenate([vowel("ah", 0.3), silence(0.3)])
    frames = []
    for step in range(round(seconds * 50)):
        at_s = step / 50
        if at_s < talk_until_s:
            start = step * FRAME % len(voice)
            face.hear(voice[start : start + FRAME], at_s)
        frames += [face.fill(source.frame_at(s), s) for s in (at_s + 0.02, at_s + 0.03)]
    return frames


def test_the_voice_takes_over_and_hands_back_without_a_snap() -> None:
    frames = play(Lossy(1.0, 3.0), 4.0, talk_until_s=4.0)
    assert all(frame.has_face for frame in frames)
    values = np.array([frame.arkit for frame in frames])
    assert np.ptp(values[150:290, JAW]) > 0.15  # it speaks while it is not seen
    tracker = values[50]
    np.testing.assert_array_equal(values[:95], np.broadcast_to(tracker, (95, 52)))
    np.testing.assert_array_equal(values[-50:], np.broadcast_to(tracker, (50, 52)))
    # Mouths are as fast as speech, and lids as a blink; what is slow shows a snap.
    slow = [name.startswith(("brow", "cheek", "nose")) for name in ARKIT_NAMES]
    steps = np.abs(np.diff(values, axis=0))[:, slow].max(1)
    assert steps[98:125].max() < 0.02 / SEAM_S
    assert steps[298:325].max() < 0.02 / SEAM_S
    assert np.all(np.diff([frame.captured_us for frame in frames]) >= 0)


def test_who_is_silent_and_unseen_for_long_has_no_face() -> None:
    frames = play(Unseen(), SILENT_AFTER_S + 3, talk_until_s=1.0)
    assert frames[60].has_face
    assert not frames[-1].has_face


def test_a_program_has_a_face_before_it_speaks_that_blinks_and_looks_around() -> None:
    face = SpokenFace(stays=True)
    frames = [face.fill(Unseen().frame_at(t / 30), t / 30) for t in range(300)]
    shapes = np.array([frame.arkit for frame in frames[10:]])
    assert all(frame.has_face for frame in frames[1:])
    assert shapes[:, ARKIT_INDEX["eyeBlinkLeft"]].max() > 0.9
    assert np.ptp(shapes[:, ARKIT_INDEX["eyeLookInLeft"]]) > 0.1
    assert not shapes[:, MOUTH].any()


def test_nobody_is_filled_in_for_before_they_have_spoken() -> None:
    assert not play(Unseen(), 0.5, talk_until_s=0.0)[-1].has_face
