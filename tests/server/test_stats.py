import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_server.stats import BOUNDS_S, LatencyHistogram, RelayStats

pytestmark = pytest.mark.unit


@given(st.lists(st.floats(0, 5), min_size=1, max_size=200), st.sampled_from([50, 99, 100]))
def test_a_percentile_is_the_bound_above_it(latencies_s: list[float], percent: int) -> None:
    histogram = LatencyHistogram()
    for latency_s in latencies_s:
        histogram.record(latency_s)
    bound_s = histogram.percentile_s(percent)
    assert bound_s in BOUNDS_S
    ranked = sorted(latencies_s)[math.ceil(len(latencies_s) * percent / 100) - 1]
    assert ranked <= bound_s
    assert not any(ranked <= lower_s < bound_s for lower_s in BOUNDS_S)


def test_without_latencies_there_is_no_percentile() -> None:
    assert LatencyHistogram().percentile_s(99) is None


def test_the_numbers_can_be_printed_as_json() -> None:
    stats = RelayStats()
    stats.forwarding.record(0.002)
    stats.closed[1000] += 1
    printed = json.loads(json.dumps(stats.as_dict()))
    assert printed["forward_ms"]["p99"] == 2.0
    assert printed["closed"] == {"1000": 1}
