"""The parts of the playout buffer, each on its own, some against a naive twin."""

from __future__ import annotations

import math
import random
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.playout_trial import face
from pica_client.playout.clock_map import FALL_S, ClockMap, hull_line
from pica_client.playout.config import PlayoutConfig
from pica_client.playout.frame_interval import FrameInterval
from pica_client.playout.jitter import JitterEstimate
from pica_client.playout.motion import Correction, Distance, blend, coasted_s, distance
from pica_client.playout.playhead import Playhead
from pica_client.playout.rotation import blend_rotations, turn_between, turned
from pica_core.codec.latent_sample import DecodedFrame

pytestmark = pytest.mark.unit

FRAME_S = 1 / 30
LIMIT = Distance(latent=10.0, turn_rad=3.0, move_m=0.5)


# The clock map


def mapped(
    seconds: float, *, ppm: float = 0.0, jitter_s: float = 0.0, fps: float = 30.0, seed: int = 0
) -> ClockMap:
    """A map of a sender whose clock is 1000 s behind ours and drifts."""
    rng = random.Random(seed)
    clock = ClockMap(0.0, 1000.04)
    for index in range(int(seconds * fps)):
        captured_s = index / fps
        arrived_s = 1000.04 + captured_s + rng.uniform(0, jitter_s)
        clock.receive(captured_s * (1 + ppm * 1e-6), arrived_s)
    return clock


@pytest.mark.parametrize("ppm", [-200.0, 0.0, 50.0, 200.0])
def test_a_steady_drift_is_found_in_ten_seconds_and_kept_for_minutes(ppm: float) -> None:
    assert mapped(10, ppm=ppm).drift_ppm == pytest.approx(ppm, abs=5)
    assert mapped(180, ppm=ppm).drift_ppm == pytest.approx(ppm, abs=1)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("jitter_s", [0.02, 0.08, 0.2])
def test_jitter_hides_no_drift_and_makes_none(jitter_s: float, seed: int) -> None:
    for ppm in (-200.0, 0.0, 200.0):
        found_ppm = mapped(120, ppm=ppm, jitter_s=jitter_s, seed=seed).drift_ppm
        assert found_ppm == pytest.approx(ppm, abs=60)


@pytest.mark.parametrize("ppm", [-200.0, 200.0])
def test_the_fastest_transit_follows_the_drift_to_a_millisecond(ppm: float) -> None:
    clock = mapped(120, ppm=ppm, jitter_s=0.08)
    captured_s = 120 * (1 + ppm * 1e-6)
    true_s = 1000.04 + 120 - captured_s
    assert clock.fastest_transit_s(captured_s) == pytest.approx(true_s, abs=0.003)
    assert clock.media_s(1000.04 + 120) == pytest.approx(captured_s, abs=0.003)


def test_both_directions_of_the_map_agree() -> None:
    clock = mapped(60, ppm=200)
    for media_s in (0.0, 59.0, 1e6):
        now = media_s + clock.fastest_transit_s(media_s)
        assert clock.media_s(now) == pytest.approx(media_s, abs=1e-6)


@pytest.mark.parametrize("step_s", [-0.1, -0.05, 0.05, 0.1])
def test_a_step_of_the_way_is_no_drift(step_s: float) -> None:
    clock = ClockMap(0.0, 0.2)
    drifts_ppm = []
    for index in range(30 * 120):
        captured_s = index * FRAME_S
        clock.receive(captured_s, captured_s + 0.2 + (step_s if captured_s > 30 else 0.0))
        drifts_ppm.append(abs(clock.drift_ppm))
    # While the halves of the memory cannot be told apart it may show, at most for some seconds.
    assert sum(drift > 50 for drift in drifts_ppm) <= 30 * 20
    assert drifts_ppm[-1] < 1
    assert clock.fastest_transit_s(120.0) == pytest.approx(0.2 + step_s, abs=0.001)


def test_one_frame_alone_lowers_the_map_by_little_and_three_by_what_they_say() -> None:
    clock = ClockMap(0.0, 0.2)
    for index in range(60):
        clock.receive(index * FRAME_S, index * FRAME_S + 0.2)
    believed_s = clock.receive(2.0, 1.8)
    assert believed_s == pytest.approx(0.2 - FALL_S)
    assert clock.fastest_transit_s(2.0) == pytest.approx(0.2 - FALL_S)
    for index in range(61, 64):
        clock.receive(index * FRAME_S, index * FRAME_S + 0.1)
    assert clock.fastest_transit_s(2.1) == pytest.approx(0.1)


@settings(deadline=None, derandomize=True)
@given(
    heights=st.lists(st.floats(0, 100), min_size=2, max_size=12),
    widths=st.lists(st.integers(1, 5), min_size=12, max_size=12),
)
def test_the_hull_line_is_the_best_line_below_all_points(
    heights: list[float], widths: list[int]
) -> None:
    points, x = [], 0.0
    for height, width in zip(heights, widths, strict=False):
        points.append((x, height))
        x += width
    slope, (x0, y0) = hull_line(points)
    tolerance = 1e-6 * (1 + max(heights))
    assert all(y0 + slope * (x - x0) <= y + tolerance for x, y in points)

    def mean_gap(line_slope: float, through: tuple[float, float]) -> float:
        return sum(y - through[1] - line_slope * (x - through[0]) for x, y in points)

    for first in points:
        for second in points:
            if second[0] <= first[0]:
                continue
            other = (second[1] - first[1]) / (second[0] - first[0])
            if all(first[1] + other * (x - first[0]) <= y + 1e-9 for x, y in points):
                assert mean_gap(slope, (x0, y0)) <= mean_gap(other, first) + 100 * tolerance


# Jitter


def test_jitter_is_what_a_plain_sort_of_the_windows_says() -> None:
    rng = random.Random(4)
    clock, estimate = ClockMap(0.0, 0.0), JitterEstimate(quantile=0.95, window_s=6.0)
    frames: list[tuple[float, float, bool]] = []
    arrived_s = -1.0
    for index in range(600):
        media_s, before_s = index * FRAME_S, arrived_s
        lateness_s = rng.expovariate(50) if index % 100 < 50 else 0.0
        arrived_s = max(arrived_s, media_s + lateness_s)
        estimate.receive(arrived_s, media_s, clock)
        frames.append((media_s, arrived_s, arrived_s - before_s >= 0.5 * FRAME_S))
        recent = [frame for frame in frames if frame[1] >= arrived_s - 6.0]
        late_s = [at - captured - clock.fastest_transit_s(captured) for captured, at, _ in recent]
        delays_s = sorted(
            each_s for each_s, (_, _, is_alone) in zip(late_s, recent, strict=True) if is_alone
        )
        wanted_s = delays_s[math.ceil(0.95 * len(delays_s)) - 1] - min(late_s)
        assert estimate.base_s == pytest.approx(min(late_s), abs=1e-9)
        assert estimate.jitter_s >= wanted_s - 1e-9
        if index % 100 == 99:  # the last second was calm
            assert estimate.jitter_s == pytest.approx(wanted_s, abs=1e-9)


def test_a_stall_now_and_then_is_not_waited_for() -> None:
    clock, estimate = ClockMap(0.0, 0.0), JitterEstimate(quantile=0.95, window_s=6.0)
    for index in range(600):
        media_s = index * FRAME_S
        since_s = media_s % 2.0
        arrived_s = media_s + (0.4 - since_s if since_s < 0.4 else 0.0)
        estimate.receive(arrived_s, media_s, clock)
        assert index < 100 or estimate.jitter_s == pytest.approx(0, abs=1e-9)


def test_three_delays_in_a_second_are_enough_to_be_waited_for() -> None:
    clock, estimate = ClockMap(0.0, 0.0), JitterEstimate(quantile=0.95, window_s=6.0)
    arrived_s = 0.0
    for index in range(300):
        media_s = index * FRAME_S
        delay_s = 0.08 if index in (280, 286, 292) else 0.0
        arrived_s = max(arrived_s, media_s + delay_s)  # those behind it wait, too
        estimate.receive(arrived_s, media_s, clock)
        if index == 291:
            assert estimate.jitter_s <= 0.014
    assert estimate.jitter_s == pytest.approx(0.08, abs=1e-9)


def test_what_all_frames_have_in_common_is_no_jitter() -> None:
    clock, estimate = ClockMap(0.0, 0.0), JitterEstimate(quantile=0.95, window_s=6.0)
    for index in range(600):
        media_s = index * FRAME_S
        arrived_s = media_s + (0.3 if index > 200 else 0.0)
        estimate.receive(arrived_s, media_s, clock)
    assert estimate.base_s == pytest.approx(0.3, abs=1e-6)
    assert estimate.jitter_s == pytest.approx(0, abs=1e-6)


# Frame interval


def test_the_interval_stands_while_a_third_of_the_frames_is_lost() -> None:
    rng = random.Random(7)
    interval, num_dropped = FrameInterval(), 0
    for index in range(1000):
        if 0 < index < 950 and rng.random() < 0.2:
            num_dropped += 1
            continue
        interval.receive(DecodedFrame(index, 0, face(0.0), index * FRAME_S))
    assert interval.interval_s == pytest.approx(FRAME_S)
    assert interval.num_lost == pytest.approx(num_dropped, rel=0.05)


@pytest.mark.parametrize("every", [2, 4])
def test_thinning_in_the_middle_of_a_stream_is_no_loss(every: int) -> None:
    interval = FrameInterval()
    for index in range(900):
        if not 300 <= index < 600 or index % every == 0:
            interval.receive(DecodedFrame(index, 0, face(0.0), index * FRAME_S))
        if index == 590:
            assert interval.interval_s == pytest.approx(every * FRAME_S)
    assert (interval.num_lost, interval.interval_s) == (0, pytest.approx(FRAME_S))


def test_frames_that_are_merely_overtaken_are_not_lost() -> None:
    rng = random.Random(3)
    interval = FrameInterval()
    order = sorted(range(500), key=lambda index: index + rng.uniform(0, 6))
    for index in order:
        interval.receive(DecodedFrame(index, 0, face(0.0), index * FRAME_S))
    assert interval.num_lost == 0


# The display's time


def test_display_time_speeds_up_by_a_tenth_and_slows_down_by_a_quarter() -> None:
    media = Playhead(PlayoutConfig(leap_s=1.0))
    media.advance(0.0, 10.0, math.inf)
    assert media.advance(0.1, 10.5, math.inf).moved_s == pytest.approx(0.11)
    assert media.advance(0.2, 10.0, math.inf).moved_s == pytest.approx(0.075)
    assert media.position_s == pytest.approx(10.185)


def test_display_time_that_is_far_behind_leaps_and_never_back() -> None:
    media = Playhead(PlayoutConfig(leap_s=1.0))
    media.advance(0.0, 10.0, math.inf)
    assert media.advance(0.1, 15.0, math.inf).is_leap
    assert (media.position_s, media.num_leaps) == (15.0, 1)
    assert not media.advance(0.2, 3.0, math.inf).is_leap
    assert media.position_s == pytest.approx(15.075)


def test_where_nothing_moves_any_more_display_time_may_fall_back() -> None:
    media = Playhead(PlayoutConfig(leap_s=1.0))
    media.advance(0.0, 10.0, math.inf)
    media.advance(1.0, 11.0, 10.3)
    assert media.advance(1.1, 10.6, 10.3).moved_s == 0
    assert media.position_s == pytest.approx(10.6)
    media.advance(1.2, 9.0, 10.3)
    assert media.position_s == pytest.approx(10.3)


def test_a_clock_that_steps_back_stops_the_display() -> None:
    media = Playhead(PlayoutConfig(leap_s=1.0))
    media.advance(5.0, 10.0, math.inf)
    media.advance(4.0, 9.0, math.inf)
    assert media.position_s == 10.0


# Motion

vectors = st.lists(st.floats(-2, 2), min_size=3, max_size=3).map(
    lambda parts: np.array(parts, np.float32)
)


def matrix(
    rotation: np.ndarray[tuple[int], np.dtype[np.float32]],
) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Rodrigues' formula."""
    x, y, z = rotation.astype(np.float64)
    angle = math.hypot(x, y, z)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    if angle < 1e-9:
        return np.eye(3) + cross
    cross /= angle
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


@settings(deadline=None, derandomize=True)
@given(begin=vectors, end=vectors)
def test_a_turn_is_what_its_matrix_says(
    begin: np.ndarray[tuple[int], np.dtype[np.float32]],
    end: np.ndarray[tuple[int], np.dtype[np.float32]],
) -> None:
    turn = turn_between(begin, end)
    assert matrix(turn) == pytest.approx(matrix(end) @ matrix(begin).T, abs=1e-5)
    assert matrix(turned(begin, turn)) == pytest.approx(matrix(end), abs=1e-5)


@settings(deadline=None, derandomize=True)
@given(begin=vectors, end=vectors, weight=st.floats(0, 3))
def test_rotations_blend_at_constant_angular_speed_and_beyond_the_end(
    begin: np.ndarray[tuple[int], np.dtype[np.float32]],
    end: np.ndarray[tuple[int], np.dtype[np.float32]],
    weight: float,
) -> None:
    turn = turn_between(begin, end)
    if np.linalg.norm(turn) > 3.1:
        return  # half a turn has two shortest ways
    expected = matrix(turned(begin, (weight * turn).astype(np.float32)))
    assert matrix(blend_rotations(begin, end, weight)) == pytest.approx(expected, abs=1e-3)


def test_rotations_blend_along_the_shorter_way() -> None:
    before = np.array([0, 3.0, 0], np.float32)
    after = np.array([0, -3.0, 0], np.float32)
    middle = blend_rotations(before, after, 0.5)
    assert abs(middle[1]) == pytest.approx(math.pi, abs=1e-5)
    for weight, end in ((0.0, before), (1.0, after)):
        assert blend_rotations(before, end, weight) == pytest.approx(end, abs=1e-6)


def test_a_turn_does_not_bend_the_way_of_the_head() -> None:
    begin, end = face(0.0, yaw=0.0), face(1.0, yaw=1.5)
    places = [blend(begin, end, index / 8).translation_m for index in range(9)]
    moves = [after - before for before, after in pairwise(places)]
    for move in moves:
        assert move == pytest.approx([0.0125, 0, 0], abs=1e-6)


def test_coasting_slows_down_evenly_and_rests() -> None:
    assert coasted_s(0.001, 0.1) == pytest.approx(0.001, rel=0.01)
    assert coasted_s(0.1, 0.1) == coasted_s(5.0, 0.1) == pytest.approx(0.05)
    assert coasted_s(0.05, 0.1) == pytest.approx(0.0375)
    assert coasted_s(1.0, 0.0) == 0.0


def test_a_correction_takes_its_time_whatever_the_true_face_does() -> None:
    correction = Correction(seconds=0.15, limit=LIMIT)
    true = face(0.0)
    correction.aim(face(0.6, yaw=0.2), true)
    apart = []
    for index in range(1, 14):
        true = face(math.sin(index))
        apart.append(distance(correction.corrected(true, 1 / 90), true).latent)
    assert [before - after for before, after in pairwise(apart[:-1])] == pytest.approx(
        [0.6 / 13.5] * 11, abs=1e-5
    )
    assert correction.corrected(true, 1 / 90) is true
    assert correction.largest_step == pytest.approx(0.6 / 13.5, abs=1e-5)


def test_a_large_correction_is_as_fast_as_its_limit_and_no_faster() -> None:
    correction = Correction(seconds=0.15, limit=LIMIT)
    begin, true = face(8.0, yaw=2.0), face(0.0)
    correction.aim(begin, true)
    shown, count = begin, 0
    while shown is not true:
        before, shown = shown, correction.corrected(true, 1 / 90)
        step = distance(before, shown)
        assert step.latent <= 10 / 90 + 1e-4
        assert step.turn_rad <= 3 / 90 + 1e-4
        assert step.move_m <= 0.5 / 90 + 1e-4
        count += 1
    assert count == pytest.approx(0.8 / 0.5 * 90, abs=1)  # the head moves 0.8 m
    assert shown is true


def test_a_correction_under_way_is_not_begun_again_by_no_news() -> None:
    correction = Correction(seconds=0.15, limit=LIMIT)
    true = face(0.0)
    correction.aim(face(0.5), true)
    for _ in range(13):
        shown = correction.corrected(true, 1 / 90)
        correction.aim(shown, true)
    assert correction.corrected(true, 1 / 90) is true
