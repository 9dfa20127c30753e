"""The performances that ship against the statistics of seven real Live Link Face takes."""

from __future__ import annotations

import numpy as np
import pytest

from pica_client.sources.performances import PERFORMANCES, make_performance
from pica_core.avatar.arkit import ARKIT_INDEX

pytestmark = pytest.mark.unit

FPS = 30


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", PERFORMANCES)
def test_a_performance_has_the_statistics_of_real_recordings(name: str, seed: int) -> None:
    recording = make_performance(name, seed=seed)
    values = np.stack([recording.frame_at(index / FPS).arkit for index in range(60 * FPS)])
    energy = np.linalg.svd(values - values.mean(axis=0), compute_uv=False) ** 2
    components = int(np.searchsorted(np.cumsum(energy) / energy.sum(), 0.95)) + 1
    low, high = {"talk": (5, 6), "listen": (4, 6), "range_of_motion": (12, 15)}[name]
    assert low <= components <= high
    steps = np.abs(np.diff(values, axis=0))
    assert 0.001 <= steps.mean() <= 0.006
    assert steps.max() >= 0.4  # a blink jumps
    assert values.min() >= 0
    assert values.max() <= 1
    assert (values[:, ARKIT_INDEX["mouthClose"]] - values[:, ARKIT_INDEX["jawOpen"]]).max() <= 0.07
    assert np.degrees(np.abs(recording.rotation).max()) <= 20


@pytest.mark.parametrize("name", PERFORMANCES)
def test_the_loop_closes_without_a_jump(name: str) -> None:
    recording = make_performance(name)
    for track in (recording.arkit, recording.rotation, recording.translation_m):
        assert np.abs(track[-1] - track[0]).max() <= 0.02


def test_every_seed_is_another_player_or_begins_elsewhere() -> None:
    faces = [make_performance("talk", seed=seed).frame_at(7.0).arkit for seed in range(12)]
    assert len({face.tobytes() for face in faces}) == 12
