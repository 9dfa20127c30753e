import json
import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_server.stats import LatencyHistogram, RelayStats

pytestmark = pytest.mark.unit


@given(st.lists(st.floats(2e-6, 100), min_size=100, max_size=200))
def test_percentiles_lie_within_five_percent(latencies_s: list[float]) -> None:
    histogram = LatencyHistogram()
    for latency_s in latencies_s:
        histogram.record(latency_s)
    median_s = statistics.median_low(latencies_s)
    assert histogram.percentile_s(50) == pytest.approx(median_s, rel=0.05)
    assert histogram.percentile_s(100) == pytest.approx(max(latencies_s), rel=0.05)


def test_without_latencies_there_is_no_percentile() -> None:
    assert LatencyHistogram().percentile_s(99) is None


@pytest.mark.parametrize("latency_s", [-1.0, 0.0, 1e9])
def test_extreme_latencies_are_counted_at_the_edge(latency_s: float) -> None:
    histogram = LatencyHistogram()
    histogram.record(latency_s)
    assert histogram.count == 1
    assert histogram.percentile_s(50) is not None


def test_the_numbers_can_be_printed_as_json() -> None:
    stats = RelayStats()
    stats.forwarding.record(0.002)
    stats.closed[1000] += 1
    printed = json.loads(json.dumps(stats.as_dict()))
    assert printed["forward_ms"]["p99"] == pytest.approx(2.0, rel=0.05)
    assert printed["closed"] == {"1000": 1}
