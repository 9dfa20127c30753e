"""A real call through a bad network: what the bench says of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from helpers.toy import make_toy_avatar
from pica_client.bench.call import BenchConfig, NetworkOptions, run_bench
from pica_client.bench.impaired_call_compare import TrueFace
from pica_client.local_call.local_call import LocalCallConfig
from pica_core.avatar.file import save_avatar
from pica_core.codec.latent_sample import LatentSample

pytestmark = pytest.mark.realtime


def sample(value: float, *, is_still: bool = False) -> LatentSample:
    return LatentSample(
        latent=np.full((8, 8, 4), value, np.float32),
        rotation=np.zeros(3, np.float32),
        translation_m=np.zeros(3, np.float32),
        is_still=is_still,
    )


def test_a_slow_network_shows_in_latency_and_in_the_rendered_face(tmp_path: Path) -> None:
    avatar = tmp_path / "toy.pica"
    save_avatar(avatar, make_toy_avatar())
    result = run_bench(
        BenchConfig(
            call=LocalCallConfig(peers=1, avatar=str(avatar)),
            seconds=2.0,
            network=NetworkOptions(delay=150),
        ),
        avatar_files=[avatar],
    )
    assert result["latency_ms"]["p50"] >= 150
    rendered = result["rendered"]
    assert rendered["age_ms"]["p50"] >= 150
    assert rendered["renders"] > 10
    assert rendered["mse_now"] > rendered["mse_delayed"]
    assert result["impairment"]["delay_s"] == 0.15


def test_the_undisturbed_face_lies_between_its_frames() -> None:
    true = TrueFace()
    for index in range(3):
        true.add(index * 1000, sample(index))
    between = true.at(1500)
    assert between is not None
    assert between.latent[0, 0, 0] == pytest.approx(1.5)
    assert true.at(-1) is None
    assert true.at(2001) is None


def test_the_undisturbed_face_is_still_where_its_sender_says_so() -> None:
    true = TrueFace()
    true.add(0, sample(0, is_still=True))
    true.add(1_000_000, sample(1))
    still = true.at(900_000)
    assert still is not None
    assert still.latent.max() == 0
