"""A real call through a bad network: what the bench says of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from helpers.toy import make_toy_avatar
from pica_client.bench.call import BenchConfig, NetworkOptions, run_bench
from pica_client.local_call.local_call import LocalCallConfig
from pica_core.avatar.file import save_avatar

pytestmark = pytest.mark.realtime


def test_a_slow_network_shows_in_the_latency(tmp_path: Path) -> None:
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
    assert result["impairment"]["delay_s"] == 0.15
