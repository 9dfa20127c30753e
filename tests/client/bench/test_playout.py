"""The comparison of playout policies: its figures mean what the module says."""

from __future__ import annotations

import json

import pytest

from helpers.toy import make_toy_avatar, without_stream
from pica_client.bench.network.stream_trial import Schedule
from pica_client.bench.playout import BenchPlayoutConfig, run_bench_playout
from pica_core.errors import ProfileError

pytestmark = pytest.mark.render

SHORT = BenchPlayoutConfig(
    source="performance:range_of_motion",
    scenarios=("jitter-0", "stall-300"),
    schedule=Schedule(seconds=9.0),
    renders_per_s=4.0,
)
TOY = make_toy_avatar()


def test_rows_are_repeatable_and_compare_every_policy() -> None:
    result = run_bench_playout(SHORT, TOY)
    assert json.loads(json.dumps(result)) == json.loads(json.dumps(run_bench_playout(SHORT, TOY)))
    rows = {(row["scenario"], row["policy"]): row for row in result["rows"]}
    assert len(rows) == 4
    calm, stalled = (rows[name, "fixed"] for name in ("jitter-0", "stall-300"))
    assert calm["concealed_ratio"] == 0
    assert calm["added_delay_ms_p50"] == pytest.approx(100, abs=1)
    assert stalled["concealed_ratio"] > 0.02
    # 300 ms of silence and up to one frame interval, less the 100 ms that were in the buffer.
    assert stalled["longest_gap_ms"] == pytest.approx(217, abs=20)
    assert calm["longest_gap_ms"] == 0


def test_an_avatar_without_a_profile_is_refused_with_the_fix() -> None:
    with pytest.raises(ProfileError, match="no stream profile, which a call needs; `pica export`"):
        run_bench_playout(SHORT, without_stream(TOY))
