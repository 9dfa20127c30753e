import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_server.limits import MOST_REMEMBERED, SocketGuard, TokenBucket

pytestmark = pytest.mark.unit


def test_a_full_bucket_gives_its_burst_and_then_its_rate() -> None:
    bucket = TokenBucket(rate=2.0, burst=3.0, now=0.0)
    assert [bucket.take(0.0) for _ in range(4)] == [True, True, True, False]
    assert [bucket.take(0.5) for _ in range(2)] == [True, False]
    assert [bucket.take(100.0) for _ in range(4)] == [True, True, True, False]


@given(st.lists(st.tuples(st.floats(-1, 5), st.floats(0.1, 9)), max_size=60))
def test_no_more_goes_through_than_burst_and_rate_allow(steps: list[tuple[float, float]]) -> None:
    bucket = TokenBucket(rate=2.0, burst=5.0, now=0.0)
    now = waited_s = taken = 0.0
    for step_s, amount in steps:  # the clock may go back
        now += step_s
        waited_s += max(step_s, 0.0)
        taken += amount * bucket.take(now, amount)
        assert taken <= 5.0 + 2.0 * waited_s + 1e-6


def guard_of(
    handshakes: int = 1000, per_address: int = 1000, per_s: float = 1000, burst: float = 1000
) -> SocketGuard:
    return SocketGuard(handshakes=handshakes, per_address=per_address, per_s=per_s, burst=burst)


def test_sockets_are_refused_above_the_limits_and_let_in_below_them_again() -> None:
    guard = guard_of(handshakes=3, per_address=2)
    admitted = [guard.admit("a", 0.0), guard.admit("a", 0.0), guard.admit("a", 0.0)]
    assert admitted == [True, True, False]
    assert [guard.admit("", 0.0), guard.admit("b", 0.0)] == [True, False]  # three shake hands
    guard.opened()
    assert guard.admit("b", 0.0)
    guard.closed("a", was_opened=True)
    guard.closed("b", was_opened=False)
    assert guard.admit("a", 0.0)


def test_an_address_that_comes_too_often_waits_and_costs_no_other_one_anything() -> None:
    guard = guard_of(per_s=2, burst=3)
    assert [guard.admit("a", 0.0) for _ in range(4)] == [True, True, True, False]
    assert guard.admit("b", 0.0)
    assert all(guard.admit("", 0.0) for _ in range(9))  # this machine
    assert [guard.admit("a", 0.5), guard.admit("a", 0.5)] == [True, False]


def test_the_pace_of_many_addresses_takes_a_bounded_memory() -> None:
    guard = guard_of(handshakes=10 * MOST_REMEMBERED, per_s=1, burst=1)
    assert guard.admit("first", 0.0)
    assert not guard.admit("first", 0.0)
    for number in range(MOST_REMEMBERED):
        guard.admit(str(number), 0.0)
    assert guard.admit("first", 0.0)  # forgotten
    assert not guard.admit(str(MOST_REMEMBERED - 1), 0.0)
