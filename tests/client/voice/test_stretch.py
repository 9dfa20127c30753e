import numpy as np
import pytest

from helpers.spoken import hum
from pica_client.voice import stretch
from pica_client.voice.comfort_noise import LOUDEST, SIZE, ComfortNoise
from pica_client.voice.packet import SAMPLE_RATE_HZ as RATE_HZ

pytestmark = pytest.mark.unit


@pytest.mark.parametrize("hz", [90.0, 140.0, 250.0])
def test_a_voiced_sound_is_joined_a_period_of_its_pitch_away(hz: float):
    lag = stretch.find_lag(hum(0.1, hz), is_quiet=False)
    periods = lag * hz / RATE_HZ
    assert lag > 0
    assert periods == pytest.approx(round(periods), abs=0.02)


def test_noise_is_not_joined_unless_it_is_quiet():
    noise = np.random.default_rng(0).standard_normal(2000)
    assert stretch.find_lag(noise, is_quiet=False) == 0
    assert stretch.find_lag(noise, is_quiet=True) == stretch.MAX_LAG


def test_too_short_a_sound_is_not_joined():
    assert stretch.find_lag(hum(0.1)[: stretch.MIN_LAG], is_quiet=True) == 0


@pytest.mark.parametrize("change", [stretch.shorten, stretch.lengthen])
def test_a_stretched_tone_keeps_its_pitch_and_makes_no_step(change):
    sound = hum(0.1)
    lag = stretch.find_lag(sound, is_quiet=False)

    changed = change(sound, lag)

    assert abs(len(changed) - len(sound)) == lag
    assert np.abs(np.diff(changed)).max() < 1.1 * np.abs(np.diff(sound)).max()


def test_comfort_noise_is_as_loud_and_as_dark_as_the_room():
    rng = np.random.default_rng(0)
    dark = np.convolve(0.003 * rng.standard_normal(SIZE * 200), np.ones(8) / 8, "same")
    noise = ComfortNoise()
    for begin in range(0, len(dark), SIZE):
        noise.learn(dark[begin : begin + SIZE])

    made = np.concatenate([noise.make() for _ in range(100)])

    assert np.std(made) == pytest.approx(np.std(dark), rel=0.2)
    spectra = [np.abs(np.fft.rfft(each[: SIZE * 100].reshape(-1, SIZE))) for each in (made, dark)]
    highs = [spectrum[:, 200:].mean() / spectrum[:, :50].mean() for spectrum in spectra]
    assert highs[0] == pytest.approx(highs[1], rel=0.3)


def test_comfort_noise_is_never_loud():
    noise = ComfortNoise()
    noise.learn(np.random.default_rng(0).standard_normal(SIZE))
    assert np.std(noise.make()) <= LOUDEST * 1.01
