"""The parts of the playout buffer, each on its own."""

from __future__ import annotations

import math
import random

import pytest

from helpers.playout_trial import face
from pica_client.playout.motion import Playhead
from pica_client.playout.sender_clock import DecodedFrame, FrameInterval, Transit

pytestmark = pytest.mark.unit

FRAME_S = 1 / 30


# Transit and jitter


@pytest.mark.parametrize("ppm", [-200.0, 200.0])
def test_the_fastest_transit_follows_a_drifting_clock_to_some_milliseconds(ppm: float) -> None:
    rng, transit = random.Random(0), Transit(1000.04)
    for index in range(120 * 30):
        media_s = index / 30 * (1 + ppm * 1e-6)
        transit.receive(media_s, 1000.04 + index / 30 + rng.uniform(0, 0.08))
    assert transit.fastest_s == pytest.approx(1000.04 + 120 - 120 * (1 + ppm * 1e-6), abs=0.004)


def test_jitter_is_the_share_of_delays_that_is_asked_for() -> None:
    rng, transit = random.Random(4), Transit(0.0, quantile=0.9)
    late_s = []
    for index in range(600):
        late_s.append(rng.uniform(0, 0.01))
        transit.receive(index * FRAME_S, index * FRAME_S + late_s[-1])
    recent = sorted(late_s[-180:])
    assert transit.jitter_s == pytest.approx(recent[161] - recent[0], abs=1e-3)


def test_a_stall_now_and_then_is_not_waited_for() -> None:
    transit = Transit(0.0)
    for index in range(600):
        media_s = index * FRAME_S
        since_s = media_s % 2.0
        transit.receive(media_s, media_s + (0.4 - since_s if since_s < 0.4 else 0.0))
        assert index < 100 or transit.jitter_s == pytest.approx(0, abs=1e-9)


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


def test_what_all_frames_have_in_common_is_no_jitter() -> None:
    transit = Transit(0.0)
    for index in range(600):
        media_s = index * FRAME_S
        transit.receive(media_s, media_s + (0.3 if index > 200 else 0.0))
    assert transit.fastest_s == pytest.approx(0.3)
    assert transit.jitter_s == pytest.approx(0, abs=1e-6)


# Frame interval


def test_the_interval_stands_while_a_fifth_of_the_frames_is_left_out() -> None:
    rng, interval = random.Random(7), FrameInterval()
    for index in range(1000):
        if rng.random() >= 0.2:
            interval.receive(DecodedFrame(0, face(0.0), index * FRAME_S))
            assert index < 20 or interval.interval_s == pytest.approx(FRAME_S)


# The display's time


def test_where_nothing_moves_any_more_display_time_may_fall_back() -> None:
    media = Playhead()
    media.advance(0.0, 10.0, math.inf)
    media.advance(1.0, 11.0, 10.3)
    assert media.advance(1.1, 10.6, 10.3).moved_s == 0
    assert media.position_s == pytest.approx(10.6)
    media.advance(1.2, 9.0, 10.3)
    assert media.position_s == pytest.approx(10.3)
