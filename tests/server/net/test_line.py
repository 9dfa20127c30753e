"""What may be on its way to a peer, on lines that are narrower or wider than what is wanted."""

from collections import deque

import pytest

from pica_server.net.line import QUEUE_S, Line

pytestmark = pytest.mark.unit


def waits_s(rate: float, wanted: float, delay_s: float) -> tuple[list[float], float]:
    """Send messages of 480 bytes for 20 s over a line without another limit: how long each waits
    in front of it, and which part of its bytes it carries. Rates in bytes a second."""
    line, under_way, waits = Line(), deque[tuple[float, int]](), []
    given = acked = 0
    free_s, waiting = 0.0, 0.0
    for step in range(2000):
        now, waiting = step / 100, min(waiting + wanted / 100, 4800.0)
        while under_way and under_way[0][0] <= now:
            acked = under_way.popleft()[1]
        while not line.is_full(acked, given, delay_s, now) and waiting >= 480:
            given, waiting, free_s = given + 480, waiting - 480, max(free_s, now) + 480 / rate
            under_way.append((free_s + delay_s, given))
            waits.append(free_s - now)
    return waits, acked / 20 / min(rate, wanted)


@pytest.mark.parametrize("delay_s", [0.02, 0.2])
@pytest.mark.parametrize("wanted", [25_000, 32_000])
def test_little_waits_in_front_of_a_slow_line_which_is_used(wanted: float, delay_s: float) -> None:
    waits, used = waits_s(rate=20_000, wanted=wanted, delay_s=delay_s)
    assert max(waits) < QUEUE_S + 0.25  # what comes at once is not known to be too much
    assert used > 0.95


@pytest.mark.parametrize("delay_s", [0.02, 0.6])
def test_a_line_that_carries_all_is_never_full(delay_s: float) -> None:
    waits, used = waits_s(rate=40_000, wanted=25_000, delay_s=delay_s)
    assert max(waits) < 0.05
    assert used > 0.95
