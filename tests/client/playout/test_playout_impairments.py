"""The playout buffer under a table of troubles, on a virtual clock, with seeded arrivals.

Each row's limits are what was seen, rounded up by about a quarter. The display runs at 90 Hz, the
stream at 30 fps, the trouble lasts seven seconds.
"""

from itertools import pairwise

import pytest

from helpers.playout_trial import (
    DISPLAY_HZ,
    Tick,
    Trouble,
    arrivals,
    between,
    concealed_ratio,
    play,
    steps,
)
from pica_client.playout.buffer import Playout

pytestmark = [pytest.mark.unit, pytest.mark.slow]

INTERVAL_S = 1 / 30
FRAME_US = 100_000 / 3
RETURN_S = 8.0
"""After this time without trouble the delay is at its floor: 6 s are remembered, 2 s are played
faster."""


def is_under_way(tick: Tick) -> bool:
    """Whether the face is on its way to a frame that is there."""
    played = tick.played
    return (
        played is not None
        and abs(played.captured_us / FRAME_US - round(played.captured_us / FRAME_US)) > 1e-4
    )


def stalls(length_s: float) -> tuple[tuple[float, float], ...]:
    """One every two seconds."""
    return tuple((6.0 + 2 * index, length_s) for index in range(4))


TABLE = {
    # trouble: (what, most concealed, most delay in trouble, largest step at all)
    "calm": (Trouble(), 0.0, 0.034, 0.055),
    "jitter 80 ms": (Trouble(jitter_s=0.08), 0.04, 0.12, 0.09),
    "jitter 200 ms": (Trouble(jitter_s=0.2), 0.07, 0.24, 0.085),
    "stalls of 300 ms": (Trouble(stalls=stalls(0.3)), 0.2, 0.034, 0.14),
    "stalls of 1000 ms": (Trouble(stalls=stalls(1.0)), 0.65, 0.034, 0.145),
    "one stall of 1000 ms": (Trouble(stalls=((9.0, 1.0),)), 0.17, 0.034, 0.115),
    "10 % dropped": (Trouble(dropped_ratio=0.1), 0.12, 0.034, 0.075),
    "both": (Trouble(jitter_s=0.08, dropped_ratio=0.1), 0.09, 0.12, 0.09),
}


@pytest.mark.parametrize("name", TABLE)
def test_a_troubled_stream_plays_within_its_bounds_and_recovers(name: str) -> None:
    trouble, most_concealed, most_delay_s, largest_step = TABLE[name]
    ticks = play(Playout(), arrivals(trouble))
    troubled = between(ticks, trouble.begin_s, trouble.end_s)
    assert concealed_ratio(troubled) <= most_concealed
    assert max(tick.report.delay_s for tick in troubled) <= most_delay_s
    assert max(steps(ticks)) <= largest_step
    healed = between(ticks, trouble.end_s + RETURN_S, 22.0)
    assert max(tick.report.delay_s for tick in healed) <= INTERVAL_S + 0.001
    assert concealed_ratio(healed) == 0
    moments = [tick.played.captured_us for tick in ticks if tick.played is not None]
    assert moments == sorted(moments)


def test_what_is_missed_is_the_networks_doing_and_not_the_displays() -> None:
    stalled = arrivals(Trouble(stalls=stalls(0.3)))
    missed_s = [play(Playout(), stalled, display_hz=hz)[-1].report.missed_s for hz in (90, 3)]
    assert missed_s == pytest.approx([4 * 0.26] * 2, abs=0.1)
    seldom = play(Playout(), arrivals(), display_hz=3)
    assert seldom[-1].report.missed_s == 0


def test_the_delay_changes_by_playing_a_little_faster_or_slower() -> None:
    playout = Playout()
    ticks = play(playout, arrivals(Trouble(jitter_s=0.2)))
    speeds = [
        (after.played.captured_us - before.played.captured_us) / 1e6 * DISPLAY_HZ
        for before, after in pairwise(ticks)
        if is_under_way(before) and is_under_way(after)
    ]
    assert 0.749 <= min(speeds) <= 0.76
    assert 1.09 <= max(speeds) <= 1.101


@pytest.mark.parametrize("ppm", [-200, 200])
def test_a_drifting_clock_neither_adds_delay_nor_conceals(ppm: float) -> None:
    trouble = Trouble(jitter_s=0.08, begin_s=0.0, end_s=120.0)
    playout = Playout()
    ticks = play(playout, arrivals(trouble, seconds=120, drift_ppm=ppm), seconds=120, display_hz=30)
    later = between(ticks, 20.0, 120.0)
    assert max(tick.report.delay_s for tick in later) <= INTERVAL_S + 0.082
    assert concealed_ratio(later) <= 0.01


@pytest.mark.parametrize("fps", [1, 7.5, 60, 240])
def test_a_stream_of_any_rate_waits_one_of_its_intervals_at_most_the_ceiling(fps: float) -> None:
    playout = Playout()
    ticks = play(playout, arrivals(seconds=20, fps=fps), seconds=20)
    report = playout.report()
    assert report.delay_s == pytest.approx(min(max(1 / fps, 0.004), 0.2), abs=0.001)
    assert report.interval_s == pytest.approx(1 / fps, rel=1e-3)
    assert concealed_ratio(between(ticks, 5, 20)) == 0
    assert max(steps(ticks)) <= 0.08
