"""The generated performances against the statistics of seven real Live Link Face takes."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt
import pytest

from pica_client.sources import performances as tracks
from pica_client.sources.performances import PERFORMANCES, make_performance
from pica_client.sources.source import Recording
from pica_core.avatar.arkit import ARKIT_INDEX
from pica_core.types import Float64Array

pytestmark = pytest.mark.unit

FPS = 30
SEEDS = (0, 1, 2)


def sampled(recording: Recording) -> Float64Array:
    """One minute at the stream's 30 frames a second, ``[1800, 52]``."""
    faces = [recording.frame_at(index / FPS).arkit for index in range(60 * FPS)]
    return np.stack(faces).astype(np.float64)


def components_for(values: Float64Array, share: float) -> int:
    energy = np.linalg.svd(values - values.mean(axis=0), compute_uv=False) ** 2
    return int(np.searchsorted(np.cumsum(energy) / energy.sum(), share)) + 1


def spans(mask: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and one-past-last index of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


@pytest.fixture(scope="module", params=[(name, seed) for name in PERFORMANCES for seed in SEEDS])
def performance(request: pytest.FixtureRequest) -> tuple[str, Float64Array]:
    name, seed = request.param
    return name, sampled(make_performance(name, seed=seed))


def test_few_principal_components_carry_the_face(performance: tuple[str, Float64Array]) -> None:
    name, values = performance
    low, high = {"talk": (5, 6), "listen": (4, 6), "range_of_motion": (12, 15)}[name]
    assert low <= components_for(values, 0.95) <= high


def test_the_mean_step_per_frame_is_that_of_real_recordings(
    performance: tuple[str, Float64Array],
) -> None:
    _, values = performance
    steps = np.abs(np.diff(values, axis=0))
    assert 0.001 <= steps.mean() <= 0.006
    assert steps.max() >= 0.4  # a blink jumps


def test_mouth_close_never_exceeds_the_open_jaw_by_more_than_real_ones(
    performance: tuple[str, Float64Array],
) -> None:
    _, values = performance
    margin = values[:, ARKIT_INDEX["mouthClose"]] - values[:, ARKIT_INDEX["jawOpen"]]
    assert margin.max() <= 0.07


def test_both_eyes_blink_together_every_two_to_six_seconds(
    performance: tuple[str, Float64Array],
) -> None:
    name, values = performance
    left, right = (values[:, ARKIT_INDEX[f"eyeBlink{side}"]] for side in ("Left", "Right"))
    np.testing.assert_allclose(left, right, atol=0.06)
    if name == "range_of_motion":  # which also holds the lids shut once, on purpose
        return
    starts = [begin / FPS for begin, _ in spans(left > 0.6)]
    gaps = np.diff(starts)
    assert len(starts) >= 8
    assert gaps.min() >= 1.9
    assert gaps.max() <= 6.2


@pytest.mark.parametrize("seed", SEEDS)
def test_a_blink_lasts_150_to_300_milliseconds(seed: int) -> None:
    lids = tracks.Player(np.random.default_rng(seed), 120).blinks()
    lengths_s = [(end - begin + 1) / tracks.SAMPLE_FPS for begin, end in spans(lids > 0)]
    assert len(lengths_s) >= 20
    assert min(lengths_s) >= 0.150
    assert max(lengths_s) <= 0.300


@pytest.mark.parametrize("seed", SEEDS)
def test_speech_has_four_to_five_syllables_a_second_and_pauses(seed: int) -> None:
    jaw = tracks.Player(np.random.default_rng(seed), 120).speech()["jaw"]
    phrases = [span for span in spans(jaw > 0.02) if span[1] - span[0] > 0.5 * tracks.SAMPLE_FPS]
    talking = sum(end - begin for begin, end in phrases)
    peaks = np.flatnonzero((jaw[1:-1] > jaw[:-2]) & (jaw[1:-1] >= jaw[2:]) & (jaw[1:-1] > 0.1))
    assert 4.0 <= len(peaks) / (talking / tracks.SAMPLE_FPS) <= 5.0
    pauses_s = [
        (after - before) / tracks.SAMPLE_FPS
        for (_, before), (after, _) in itertools.pairwise(phrases)
    ]
    assert len(pauses_s) >= 15
    assert min(pauses_s) >= 0.2
    assert max(pauses_s) <= 1.5


@pytest.mark.parametrize("name", PERFORMANCES)
def test_the_head_moves_a_little_and_never_far(name: str) -> None:
    recording = make_performance(name)
    assert 0.5 <= np.degrees(recording.rotation.std(axis=0)).max() <= 6
    assert np.degrees(np.abs(recording.rotation).max()) <= 20
    assert np.abs(recording.translation_m).max() <= 0.04


@pytest.mark.parametrize("name", PERFORMANCES)
def test_the_loop_closes_without_a_jump(name: str) -> None:
    recording = make_performance(name)
    for track in (recording.arkit, recording.rotation, recording.translation_m):
        assert np.abs(track[-1] - track[0]).max() <= 0.02
