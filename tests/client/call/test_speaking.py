"""The speaking hint: what is read out of latents is the jaw, and what moves like speech speaks."""

import math

import numpy as np
import numpy.typing as npt
import pytest

from pica_client.call.speaking import DEAD_BAND, HOLD_S, JawReader, SpeakingMeter
from pica_client.sources import open_source
from pica_core.avatar.arkit import ARKIT_INDEX, NUM_ARKIT
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import Avatar, load_avatar, shipped_avatar_files

pytestmark = [pytest.mark.unit, pytest.mark.slow]

FPS = 30
JAW = ARKIT_INDEX["jawOpen"]


@pytest.fixture(scope="module", params=shipped_avatar_files(), ids=lambda path: path.stem)
def shipped(request: pytest.FixtureRequest) -> Avatar:
    return load_avatar(request.param)


def perform(avatar: Avatar, name: str, seconds: float) -> tuple[npt.NDArray, npt.NDArray]:
    """True jawOpen ``[T]`` and what is read of it ``[T]``, at 30 a second."""
    source = open_source(f"performance:{name}")
    times = np.arange(round(seconds * FPS)) / FPS
    arkit = np.stack([source.frame_at(float(time)).arkit for time in times])
    reader = JawReader(avatar)
    latents = ExpressionEncoder(avatar).encode(arkit)
    return arkit[:, JAW], np.array([reader.jaw_open(latent) for latent in latents])


def watched(jaw: npt.NDArray) -> npt.NDArray:
    """Whether the meter says "speaking" at each of 30 values a second."""
    meter = SpeakingMeter()
    shown = []
    for index, value in enumerate(jaw.tolist()):
        meter.receive(value, index / FPS)
        shown.append(meter.is_speaking(index / FPS))
    return np.array(shown)


def test_what_is_read_from_latents_follows_the_true_jaw(shipped: Avatar) -> None:
    true, read = perform(shipped, "talk", 60)
    assert np.corrcoef(true, read)[0, 1] > 0.999
    assert np.abs(true - read).mean() < 0.005


def test_somebody_who_talks_speaks_and_others_hardly_do(shipped: Avatar) -> None:
    _, talking = perform(shipped, "talk", 60)
    _, listening = perform(shipped, "listen", 60)  # with a short answer now and then
    _, moving = perform(shipped, "range_of_motion", 60)  # each muscle once, the jaw among them
    assert watched(talking).mean() > 0.8
    assert watched(listening).mean() < 0.33
    assert watched(moving).mean() < 0.1


def test_a_smile_does_not_open_the_jaw(shipped: Avatar) -> None:
    rest, smile = np.zeros(NUM_ARKIT, np.float32), np.zeros(NUM_ARKIT, np.float32)
    for side in ("Left", "Right"):
        smile[ARKIT_INDEX[f"mouthSmile{side}"]] = 0.8
    encoder, reader = ExpressionEncoder(shipped), JawReader(shipped)
    change = reader.jaw_open(encoder.encode(smile)) - reader.jaw_open(encoder.encode(rest))
    assert abs(change) < 0.05


def test_a_yawn_is_no_speech() -> None:
    yawn = np.concatenate([np.zeros(60), np.linspace(0, 1, 60), np.ones(60)])
    assert not watched(yawn).any()


def test_a_face_that_trembles_within_the_coders_noise_is_silent() -> None:
    noise = np.random.default_rng(1).uniform(-DEAD_BAND, DEAD_BAND, 300)
    assert not watched(0.1 + noise).any()


def test_the_hint_holds_through_a_pause_between_words_and_then_ends() -> None:
    syllables = 0.2 + 0.15 * np.sin(np.arange(90) / FPS * 2 * math.pi * 4)
    shown = watched(np.concatenate([syllables, np.full(120, 0.05)]))
    assert shown[60:90].all()
    assert shown[90 + round(0.5 * HOLD_S * FPS)]
    assert not shown[-20:].any()


def test_what_is_not_a_number_is_not_heard() -> None:
    meter = SpeakingMeter()
    meter.receive(math.nan, 0.0)
    assert not meter.is_speaking(0.0)
