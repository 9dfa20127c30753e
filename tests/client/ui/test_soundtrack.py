import numpy as np
import pytest

from pica_client.ui.recorder import MAX_ERROR_S, Soundtrack
from pica_client.voice.opus import FRAME_SAMPLES, SAMPLE_RATE_HZ

pytestmark = pytest.mark.unit

FRAME = np.full(FRAME_SAMPLES, 0.25, np.float32)


def test_frames_that_come_unevenly_are_joined_without_a_seam() -> None:
    track, chance = Soundtrack(), np.random.default_rng(0)
    track.begin(10.0)
    for index in range(50):
        track.add("ann", FRAME, 10.0 + 0.02 * index + chance.uniform(0, MAX_ERROR_S))
    sound, first = track.take(1.0)
    assert first == 0
    heard = np.flatnonzero(sound[:, 0])
    assert len(heard) == heard[-1] - heard[0] + 1
    assert heard[0] < MAX_ERROR_S * SAMPLE_RATE_HZ


def test_a_clock_that_drifts_and_a_silence_keep_their_places() -> None:
    track = Soundtrack()
    track.begin(0.0)
    for index in range(1000):  # a thousandth too slow: 20 ms in 20 s
        track.add("ann", FRAME, 0.02002 * index)
    track.add("ann", FRAME, 25.0)
    sound, _ = track.take(26.0)
    heard = np.flatnonzero(sound[:, 0])
    assert heard[-1] + 1 == 25 * SAMPLE_RATE_HZ + FRAME_SAMPLES
    before = heard[heard < 24 * SAMPLE_RATE_HZ][-1]
    assert before == pytest.approx(20.02 * SAMPLE_RATE_HZ, abs=2 * MAX_ERROR_S * SAMPLE_RATE_HZ)


def test_voices_are_added_and_what_came_before_the_beginning_is_left_out() -> None:
    track = Soundtrack()
    track.add("ann", FRAME, 5.0)
    track.begin(5.01)
    track.add("ann", FRAME, 5.0)
    track.add("own", FRAME, 5.01)
    sound, _ = track.take(0.03)
    assert sound[0] == pytest.approx([0.5, 0.5])
    assert sound[FRAME_SAMPLES // 2 + 1] == pytest.approx([0.25, 0.25])
    assert np.all(sound[FRAME_SAMPLES:] == 0)
    assert len(track.take(0.03)[0]) == 0
    assert track.take(0.05)[1] == 3 * FRAME_SAMPLES // 2
