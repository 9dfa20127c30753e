"""How much later a tracker sees a mouth than a microphone hears it."""

import numpy as np
import pytest

from pica_client.errors import SourceError
from pica_client.sources.live.calibration import sound_offset
from pica_core.types import FloatArray

pytestmark = pytest.mark.unit

RATE_HZ, BEGIN_S = 48_000, 100.0
SAID_S = np.array([1.0, 2.1, 3.17, 4.33, 5.6])


def plosives(noise_rms: float) -> FloatArray:
    """A burst and a vowel at each of `SAID_S`, in a room."""
    chance, sound = np.random.default_rng(1), np.zeros(7 * RATE_HZ)
    for begin_s in SAID_S:
        seconds = np.arange(round(0.2 * RATE_HZ)) / RATE_HZ
        vowel = np.sin(2 * np.pi * 120 * seconds) * np.minimum(seconds / 0.05, 1)
        at = round(begin_s * RATE_HZ)
        burst = chance.normal(0, 0.1, len(seconds)) * np.exp(-seconds / 0.01)
        sound[at : at + len(seconds)] += 0.3 * vowel + burst
    return (sound + chance.normal(0, noise_rms, len(sound))).astype(np.float32)


def seen(offset_s: float, fps: float, noise: float = 0.01) -> list[tuple[float, float]]:
    """A mouth that opens in 70 ms and closes in 200, seen so much later than it is heard."""
    chance = np.random.default_rng(2)
    times_s = np.arange(0.0, 7.0, 1 / fps)
    since_s = times_s[:, None] - SAID_S - offset_s
    openings = np.clip(np.minimum(since_s / 0.07, (0.33 - since_s) / 0.2), 0, 1).max(axis=1)
    values = 0.05 + 0.5 * openings + chance.normal(0, noise, len(times_s))
    return list(zip(BEGIN_S + times_s, values, strict=True))


@pytest.mark.parametrize("fps", [30, 60])
@pytest.mark.parametrize("offset_s", [-0.04, 0.0, 0.08, 0.22])
def test_a_known_offset_is_found_within_ten_milliseconds(offset_s: float, fps: float) -> None:
    found_s, num_used = sound_offset(seen(offset_s, fps), plosives(0.001), BEGIN_S, RATE_HZ)
    assert found_s == pytest.approx(offset_s, abs=0.01)
    assert num_used >= 4


@pytest.mark.parametrize(
    ("mouth", "sound"),
    [
        (seen(0.1, 30), np.zeros(7 * RATE_HZ, np.float32)),
        ([(BEGIN_S + 0.03 * index, 0.02) for index in range(230)], plosives(0.001)),
        ([], plosives(0.001)),
        (seen(0.1, 30), plosives(0.1)),
    ],
    ids=["nothing heard", "nothing opens", "nobody seen", "a loud room"],
)
def test_what_is_not_heard_and_seen_says_how_to_do_better(
    mouth: list[tuple[float, float]], sound: FloatArray
) -> None:
    with pytest.raises(SourceError, match='say "pa"'):
        sound_offset(mouth, sound, BEGIN_S, RATE_HZ)
