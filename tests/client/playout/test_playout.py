"""The playout buffer as its callers see it, with literal times."""

import math
from itertools import pairwise

import pytest

from helpers.playout_trial import (
    DISPLAY_HZ,
    FAR_CLOCK_US,
    FRAME_S,
    WAY_S,
    Trouble,
    arrivals,
    arrive,
    between,
    captured,
    concealed_ratio,
    face,
    play,
    receive,
    shown,
    steady,
    steps,
    value_at,
    value_of,
)
from pica_client.playout.buffer import BLEND_S, CEILING_S, MAX_LAG_S, Playhead, Playout
from pica_client.playout.sender_clock import Transit

pytestmark = pytest.mark.unit


# On the display


def test_nothing_is_shown_before_the_first_frame_is_due() -> None:
    playout = Playout()
    assert playout.sample_at(0.0) is None
    receive(playout, 0, now=1.0)
    assert playout.sample_at(1.003) is None
    assert value_of(shown(playout, 1.005)) == 0


def test_between_two_frames_latent_and_head_are_interpolated() -> None:
    playout = Playout()
    arrive(playout, 0, captured(0), face(0.0, yaw=0.0), 0.0)
    arrive(playout, 1, captured(1), face(1.0, yaw=0.6), FRAME_S)
    played = shown(playout, 1.25 * FRAME_S)
    assert value_of(played) == pytest.approx(0.25, abs=1e-3)
    assert played.sample.rotation == pytest.approx([0, 0.15, 0], abs=1e-3)
    assert played.sample.translation_m[0] == pytest.approx(0.025, abs=1e-4)
    assert played.captured_us == pytest.approx(captured(0.25), abs=40)


def test_a_face_without_a_next_frame_is_concealed_once_that_is_overdue() -> None:
    playout = Playout()
    steady(playout, 31)
    at_last_s = 30 * FRAME_S + 0.01 + FRAME_S
    concealed_before = playout.report().concealed
    fresh = shown(playout, at_last_s + 0.4 * FRAME_S)
    assert not fresh.is_concealed
    held = shown(playout, at_last_s + 2 * FRAME_S)
    assert held.is_concealed
    assert held.captured_us == captured(30)
    assert playout.report().age_s == pytest.approx(3 * FRAME_S, abs=1e-4)
    assert playout.report().concealed == concealed_before + 1


def test_after_a_gap_the_face_goes_over_to_its_path_within_the_stated_time() -> None:
    playout = Playout()
    gap = [frame for frame in arrivals(seconds=4) if not 2.0 <= frame.captured_s < 2.4]
    ticks = play(playout, gap, seconds=4)
    back_s = 2.4 + WAY_S + 1 / DISPLAY_HZ
    off_path = [
        tick.now
        for tick in between(ticks, back_s, 4.0)
        if tick.played is not None
        and abs(value_of(tick.played) - value_at(tick.now - WAY_S - FRAME_S)) > 0.01
    ]
    assert off_path
    assert max(off_path) <= back_s + BLEND_S
    # Its own step, and evenly a fourteenth of what there was to go.
    assert max(steps(ticks)) <= 4.7 / DISPLAY_HZ + 1.6 / (0.15 * DISPLAY_HZ)


def test_a_frame_older_than_the_newest_changes_nothing() -> None:
    playout = Playout()
    for index in (0, 1, 2, 4):
        receive(playout, index, index * FRAME_S + 0.01)
    receive(playout, 3, 4 * FRAME_S + 0.02)
    assert value_of(shown(playout, 4 * FRAME_S)) == pytest.approx(2.7, abs=0.01)
    assert value_of(shown(playout, 1.0)) == pytest.approx(4)


def test_a_long_gap_between_frames_is_rested_in_and_then_crossed() -> None:
    playout = Playout()
    receive(playout, 0, 0.0)
    receive(playout, 10, 10 * FRAME_S)  # and is waited for as long as the ceiling
    at_s = 10 * FRAME_S + CEILING_S
    assert value_of(shown(playout, at_s - 0.26)) == 0
    assert value_of(shown(playout, at_s - 0.125)) == pytest.approx(5, abs=0.01)
    assert value_of(shown(playout, at_s)) == 10


def test_a_display_that_paused_goes_on_at_the_present() -> None:
    playout = Playout()
    steady(playout, 30)
    for index in range(30, 300):
        receive(playout, index, index * FRAME_S + 0.01)
    played = shown(playout, 299 * FRAME_S + 0.01)
    assert played.captured_us == pytest.approx(captured(298), abs=100)


@pytest.mark.parametrize("images_per_s", [12, 20])
def test_a_display_slower_than_the_stream_waits_for_no_next_frame(images_per_s: int) -> None:
    ticks = play(Playout(), arrivals(seconds=8), seconds=8, display_hz=images_per_s)
    shown_s = [
        tick.now - WAY_S - (tick.played.captured_us - FAR_CLOCK_US) / 1e6
        for tick in between(ticks, 4, 8)
        if tick.played is not None and not tick.played.is_concealed
    ]
    assert len(shown_s) == 4 * images_per_s
    assert sum(shown_s) / len(shown_s) <= 0.8 * FRAME_S


def test_jitter_that_a_slow_display_hides_conceals_nothing() -> None:
    trouble = Trouble(jitter_s=0.05, begin_s=0, end_s=20)
    ticks = play(Playout(), arrivals(trouble, seconds=20), seconds=20, display_hz=8)
    assert concealed_ratio(between(ticks, 5, 20)) == 0


# Still faces


def still_after(playout: Playout, count: int) -> float:
    """A moving face that stops at frame `count` and says so; returns when that is shown."""
    steady(playout, count)
    receive(playout, count, count * FRAME_S + 0.01, value=float(count), is_still=True)
    return (count + 1) * FRAME_S + 0.01


def test_a_still_face_is_live_while_its_sender_is_silent() -> None:
    playout = Playout()
    since_s = still_after(playout, 30)
    concealed_before = playout.report().concealed
    for later_s in (0.1, 0.5, 1.0, 2.0):
        played = shown(playout, since_s + later_s)
        assert value_of(played) == 30
        assert not played.is_concealed
        assert playout.report().age_s == pytest.approx(FRAME_S, abs=1e-4)
    assert playout.report().concealed == concealed_before
    without_heartbeats = shown(playout, since_s + 2.6)
    assert without_heartbeats.is_concealed
    assert playout.report().age_s == pytest.approx(0.1 + FRAME_S, abs=1e-3)


def test_heartbeats_keep_a_still_face_live_and_are_no_frame_rate() -> None:
    playout = Playout()
    still_after(playout, 30)
    for second in range(1, 6):
        index = 30 + 30 * second
        arrive(
            playout, 30 + second, captured(index), face(30.0, is_still=True), index * FRAME_S + 0.01
        )
        played = shown(playout, (index + 25) * FRAME_S)
        assert (value_of(played), played.is_concealed) == (30, False)
    report = playout.report()
    assert report.interval_s == pytest.approx(FRAME_S, rel=1e-3)
    assert report.delay_s == pytest.approx(FRAME_S, abs=1e-4)


def test_a_still_face_begins_to_move_one_interval_before_its_next_frame() -> None:
    playout = Playout()
    still_after(playout, 30)
    for tick in range(90):
        playout.sample_at(31 * FRAME_S + 0.02 + tick / DISPLAY_HZ)
    arrive(playout, 31, captured(75), face(36.0), 75 * FRAME_S + 0.01)
    behind_s = 0.01 + FRAME_S
    assert value_of(shown(playout, 74 * FRAME_S + behind_s)) == pytest.approx(30, abs=0.01)
    assert value_of(shown(playout, 74.5 * FRAME_S + behind_s)) == pytest.approx(33, abs=0.01)
    assert value_of(shown(playout, 75 * FRAME_S + behind_s)) == pytest.approx(36, abs=0.01)


# Thinned streams


@pytest.mark.parametrize("keeps_every", [2, 4])
def test_the_delay_of_a_thinned_stream_follows_its_interval(keeps_every: int) -> None:
    playout = Playout()
    frames = [
        frame
        for frame in arrivals(seconds=20)
        if frame.captured_s < 10 or frame.number % keeps_every == 0
    ]
    ticks = play(playout, frames, seconds=20)
    report = playout.report()
    assert report.interval_s == pytest.approx(keeps_every * FRAME_S, rel=1e-3)
    assert report.delay_s == pytest.approx(keeps_every * FRAME_S, abs=1e-3)
    assert not any(
        tick.played.is_concealed for tick in between(ticks, 12, 20) if tick.played is not None
    )
    assert max(steps(ticks)) <= 0.07


def test_a_stream_that_is_no_longer_thinned_comes_closer() -> None:
    playout = Playout()
    frames = [
        frame for frame in arrivals(seconds=20) if frame.captured_s > 10 or frame.number % 4 == 0
    ]
    ticks = play(playout, frames, seconds=20)
    assert playout.report().concealed == 0
    assert max(tick.report.delay_s for tick in between(ticks, 12.5, 20)) <= FRAME_S + 1e-3


# Led by a voice: the moment that is heard is the moment that is shown


def led(playout: Playout, now: float, heard_s: float) -> tuple[float, float]:
    """The moment shown, seconds since the first frame, and the face."""
    played = playout.sample_at(now, FAR_CLOCK_US + round(heard_s * 1e6))
    assert played is not None
    return (played.captured_us - FAR_CLOCK_US) / 1e6, value_of(played)


@pytest.mark.parametrize(("behind_s", "waits_s"), [(0.12, 0.12), (600.0, WAY_S + FRAME_S)])
def test_a_face_waits_for_the_voice_that_is_heard_unless_its_clock_is_another(
    behind_s: float, waits_s: float
) -> None:
    playout = Playout()
    for index in range(90):
        now = index * FRAME_S + WAY_S
        receive(playout, index, now)
        if index > 5:
            seen_s, _ = led(playout, now, now - behind_s)
    assert seen_s == pytest.approx(now - waits_s, abs=0.002)


def test_a_face_goes_as_fast_as_its_voice_and_never_ahead_of_it() -> None:
    playout, heard_s = Playout(), 0.0
    for index in range(120):
        now = index * FRAME_S + WAY_S
        receive(playout, index, now)
        heard_s += FRAME_S * (1.4 if 60 <= index < 75 else 1.0)
        if index == 10:
            heard_s = now - 0.3
        if index > 20:
            assert -0.045 <= led(playout, now, heard_s)[0] - heard_s <= 0.002


def test_a_face_whose_frames_are_late_catches_up_with_its_voice_without_a_snap() -> None:
    playout, values = Playout(), []
    for index in range(200):
        now = index * FRAME_S + WAY_S
        if not 100 <= index < 110:  # frames stop, the voice goes on
            for each in range(100, 111) if index == 110 else (index,):
                receive(playout, each, now)
        if index > 40:
            seen_s, value = led(playout, now, now - 0.12)
            values.append(value)
    assert seen_s == pytest.approx(now - 0.12, abs=MAX_LAG_S)
    # Ten frames are missing: it never jumps over them at once.
    assert max(abs(after - before) for before, after in pairwise(values)) < 8


# What waits and what moves


def test_three_delays_in_a_second_are_enough_to_be_waited_for() -> None:
    transit, arrived_s = Transit(0.0), 0.0
    for index in range(300):
        media_s = index * FRAME_S
        delay_s = 0.08 if index in (280, 286, 292) else 0.0
        arrived_s = max(arrived_s, media_s + delay_s)  # those behind it wait, too
        transit.receive(media_s, arrived_s)
        if index == 291:
            assert transit.jitter_s <= 0.014
    assert transit.jitter_s == pytest.approx(0.08, abs=1e-9)


def test_where_nothing_moves_any_more_display_time_may_fall_back() -> None:
    media = Playhead()
    media.advance(0.0, 10.0, math.inf)
    media.advance(1.0, 11.0, 10.3)
    assert media.advance(1.1, 10.6, 10.3).moved_s == 0
    assert media.position_s == pytest.approx(10.6)
    media.advance(1.2, 9.0, 10.3)
    assert media.position_s == pytest.approx(10.3)
