import pytest

from pica_server.coalescing import MEASURED_S, Coalescing, WaitingLine

pytestmark = pytest.mark.unit


def window_at(rate_per_s: float) -> float:
    coalescing = Coalescing(above_per_s=1000, longest_s=0.008, now=0.0)
    coalescing.note(round(rate_per_s * MEASURED_S), now=MEASURED_S)
    return coalescing.window_s


@pytest.mark.parametrize(
    ("rate_per_s", "window_s"),
    [(0, 0), (1000, 0), (1600, 0.0016), (2500, 0.004), (4000, 0.008), (1e6, 0.008)],
)
def test_the_window_grows_with_the_load_up_to_its_longest(
    rate_per_s: float, window_s: float
) -> None:
    assert window_at(rate_per_s) == pytest.approx(window_s)


def test_the_window_closes_when_the_load_is_gone() -> None:
    coalescing = Coalescing(above_per_s=1000, longest_s=0.008, now=0.0)
    coalescing.note(10_000, now=1.0)
    assert coalescing.window_s == 0.008
    coalescing.note(1, now=2.0)
    assert coalescing.window_s == 0.0


def test_who_waits_is_served_in_the_order_of_coming_when_the_time_has_come() -> None:
    line: WaitingLine[str] = WaitingLine()
    line.join("Ada", due_s=1.0)
    line.join("Bob", due_s=1.004)
    assert line.next_timer() == 1.0
    assert line.take_due(now=0.99) == []
    assert line.take_due(now=1.0) == ["Ada"]
    assert line.next_timer() == 1.004
    assert line.take_due(now=1.1) == ["Bob"]
    assert line.next_timer() is None


def test_who_waits_already_waits_no_longer_for_what_comes_then() -> None:
    line: WaitingLine[str] = WaitingLine()
    line.join("Ada", due_s=1.0)
    line.join("Ada", due_s=1.008)
    assert line.take_due(now=1.0) == ["Ada"]
    assert line.next_timer() is None
