import pytest

from pica_server.room.batching_window import BatchingWindow, Coalescing

pytestmark = pytest.mark.unit

LONGEST_S = 0.008
LOOK_S = 0.25


def windows_at(busy_ratios: list[float]) -> list[float]:
    """The window after each stretch of time in which the thread was so busy."""
    coalescing = Coalescing(busy_above=0.8, longest_s=LONGEST_S)
    processor_s = now = 0.0
    coalescing.note(processor_s, now)
    windows_s = []
    for ratio in busy_ratios:
        processor_s, now = processor_s + ratio * LOOK_S, now + LOOK_S
        coalescing.note(processor_s, now)
        windows_s.append(coalescing.window_s)
    return windows_s


def test_nothing_waits_while_the_thread_has_time_left() -> None:
    assert windows_at([0.0, 0.5, 0.79]) == [0, 0, 0]


def test_a_thread_with_nothing_left_has_the_longest_window_within_a_second() -> None:
    windows_s = windows_at([1.0] * 6)
    assert windows_s == sorted(windows_s)
    assert windows_s[3:] == pytest.approx([LONGEST_S] * 3)


def test_the_window_grows_slowly_where_it_is_nearly_wide_enough() -> None:
    nearly, full = windows_at([0.85] * 2), windows_at([1.0] * 2)
    assert 0 < nearly[1] < 0.5 * full[1]


def test_the_window_stays_while_it_is_what_keeps_the_thread_from_being_too_busy() -> None:
    windows_s = windows_at([1.0, 1.0, 0.75, 0.7])
    assert windows_s[3] == windows_s[1] > 0


def test_the_window_closes_when_the_load_is_gone() -> None:
    windows_s = windows_at([1.0] * 4 + [0.3] * 12)
    assert windows_s[4:] == sorted(windows_s[4:], reverse=True)
    assert windows_s[-1] == 0


def test_a_clock_that_stands_still_changes_nothing() -> None:
    coalescing = Coalescing(busy_above=0.8, longest_s=LONGEST_S)
    coalescing.note(0.0, now=1.0)
    coalescing.note(5.0, now=1.0)
    assert coalescing.window_s == 0


def test_who_waits_is_served_in_the_order_of_coming_when_the_time_has_come() -> None:
    line: BatchingWindow[str] = BatchingWindow()
    line.join("Ada", due_s=1.0)
    line.join("Bob", due_s=1.004)
    assert line.next_timer() == 1.0
    assert line.take_due(now=0.99) == []
    assert line.take_due(now=1.0) == ["Ada"]
    assert line.next_timer() == 1.004
    assert line.take_due(now=1.1) == ["Bob"]
    assert line.next_timer() is None


def test_who_waits_already_waits_no_longer_for_what_comes_then() -> None:
    line: BatchingWindow[str] = BatchingWindow()
    line.join("Ada", due_s=1.0)
    line.join("Ada", due_s=1.008)
    assert line.take_due(now=1.0) == ["Ada"]
    assert line.next_timer() is None
