"""The load generator against real relays: what can be counted, never how fast it was."""

import os

import pytest

from pica_client.bench.relay.bench import RelayBenchConfig
from rivals.comparison import run_comparison

pytestmark = pytest.mark.realtime

if os.name == "nt":
    pytest.skip("the load generator needs poll", allow_module_level=True)


def test_everybody_gets_every_frame_from_the_relay_and_a_naive_one() -> None:
    config = RelayBenchConfig(rooms=2, seconds=1.0)
    result = run_comparison(config)
    for row in (result, *result["compare"].values()):
        assert row["connections"] == 10
        assert row["sent_per_s"] == pytest.approx(300, rel=0.1)
        assert (row["missing"], row["errors"]) == (0, 0)
