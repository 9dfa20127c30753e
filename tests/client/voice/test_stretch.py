import numpy as np
import pytest

from helpers.spoken import hum
from pica_client.voice import stretch
from pica_client.voice.opus import SAMPLE_RATE_HZ as RATE_HZ

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
