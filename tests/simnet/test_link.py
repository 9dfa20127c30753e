import pytest
from hypothesis import given
from hypothesis import strategies as st

from simnet.link import Link, StreamLink

pytestmark = pytest.mark.unit


def test_a_plain_link_delivers_after_its_delay() -> None:
    link = StreamLink(Link(delay_s=0.05), "a")
    assert link.transmit(100, now=1.0) == 1.05


def test_a_slow_link_sends_one_segment_after_the_other() -> None:
    link = StreamLink(Link(rate_bps=8000), "a")
    assert link.transmit(500, now=0.0) == 0.5
    assert link.transmit(500, now=0.0) == 1.0


def test_a_lost_segment_holds_up_those_behind_it() -> None:
    link = StreamLink(Link(loss_ratio=0.5, seed=3), "a")
    arrivals = [link.transmit(100, now=i / 100) for i in range(100)]
    assert max(arrivals[i] - i / 100 for i in range(100)) >= 0.2
    assert arrivals == sorted(arrivals)


def test_an_outage_delays_and_loses_nothing() -> None:
    link = StreamLink(Link(), "a")
    link.hold(5.0)
    assert link.transmit(10, now=1.0) == 5.0


@given(
    jitter_s=st.floats(0, 1),
    loss_ratio=st.floats(0, 0.9),
    times=st.lists(st.floats(0, 100), min_size=1, max_size=30),
)
def test_bytes_never_overtake_and_never_arrive_early(
    jitter_s: float, loss_ratio: float, times: list[float]
) -> None:
    link = StreamLink(Link(delay_s=0.01, jitter_s=jitter_s, loss_ratio=loss_ratio), "a")
    times = sorted(times)
    arrivals = [link.transmit(100, now) for now in times]
    assert arrivals == sorted(arrivals)
    assert all(arrival >= now + 0.01 for arrival, now in zip(arrivals, times, strict=True))


def test_the_same_seed_gives_the_same_link() -> None:
    link = Link(jitter_s=0.1, loss_ratio=0.1, seed=7)
    first, second = StreamLink(link, "a"), StreamLink(link, "a")
    assert [first.transmit(9, t) for t in range(50)] == [second.transmit(9, t) for t in range(50)]
