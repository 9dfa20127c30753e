import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_server.limits import SocketGuard, TokenBucket, address_group

pytestmark = pytest.mark.unit


def test_a_full_bucket_gives_its_burst_and_then_its_rate() -> None:
    bucket = TokenBucket(rate=2.0, burst=3.0, now=0.0)
    assert [bucket.take(0.0) for _ in range(4)] == [True, True, True, False]
    assert [bucket.take(0.5) for _ in range(2)] == [True, False]
    assert [bucket.take(100.0) for _ in range(4)] == [True, True, True, False]


def test_what_is_too_much_takes_nothing() -> None:
    bucket = TokenBucket(rate=1.0, burst=10.0, now=0.0)
    assert not bucket.take(0.0, 11.0)
    assert bucket.take(0.0, 10.0)


@given(st.lists(st.tuples(st.floats(-1, 5), st.floats(0.1, 9)), max_size=60))
def test_no_more_goes_through_than_burst_and_rate_allow(steps: list[tuple[float, float]]) -> None:
    bucket = TokenBucket(rate=2.0, burst=5.0, now=0.0)
    now = waited_s = taken = 0.0
    for step_s, amount in steps:  # the clock may go back
        now += step_s
        waited_s += max(step_s, 0.0)
        taken += amount * bucket.take(now, amount)
        assert taken <= 5.0 + 2.0 * waited_s + 1e-6


@pytest.mark.parametrize(
    ("host", "group"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("2001:db8:1:2:3:4:5:6", "20010db800010002"),
        ("2001:db8:1:2::", "20010db800010002"),
        ("fe80::1%eth0", "fe80000000000000"),
        ("127.0.0.1", ""),
        ("::1", ""),
        ("::ffff:127.0.0.1", ""),
        ("a name", ""),
    ],
)
def test_what_counts_as_one_address(host: str, group: str) -> None:
    assert address_group(host) == group


def test_sockets_are_refused_above_the_limits_and_let_in_below_them_again() -> None:
    guard = SocketGuard(handshakes=3, per_address=2)
    assert [guard.admit("a"), guard.admit("a"), guard.admit("a")] == [True, True, False]
    assert [guard.admit(""), guard.admit("b")] == [True, False]  # three shake hands
    guard.opened()
    assert guard.admit("b")
    guard.closed("a", was_opened=True)
    guard.closed("b", was_opened=False)
    assert guard.admit("a")
