"""The playout buffer: literal times first, then a rule-based comparison with a naive reference."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from pica_client.playout import PlayedFace, Playout, PlayoutConfig
from pica_client.rotation import blend_rotations
from pica_core.latent_sample import LatentSample

pytestmark = pytest.mark.unit

FRAME_S = 1 / 30
FAR_CLOCK_US = 5_000_000_000
"""The sender's clock is 5000 s ahead of ours: nothing may depend on the difference."""
TICK_S = 2e-6
"""Capture times are whole microseconds: no test asks for more."""


def sample(value: float = 0.0, yaw: float = 0.0) -> LatentSample:
    return LatentSample(
        latent=np.full((8, 8, 4), value, np.float32),
        rotation=np.array([0, yaw, 0], np.float32),
        translation_m=np.array([value, 0, 0], np.float32),
    )


def captured(index: float) -> int:
    return FAR_CLOCK_US + round(index * FRAME_S * 1e6)


def receive(playout: Playout, index: int, now: float, *, value: float | None = None) -> None:
    face = sample(float(index) if value is None else value)
    playout.receive_frame(index % 65536, captured(index), face, now)


def shown(playout: Playout, now: float) -> PlayedFace:
    face = playout.sample_at(now)
    assert face is not None
    return face


def value_of(face: PlayedFace) -> float:
    return float(face.sample.latent[0, 0, 0])


def steady(playout: Playout, count: int, *, transit_s: float = 0.01) -> None:
    """`count` frames on a perfect network, each shown; frame i is captured at our i / 30 s."""
    for index in range(count):
        receive(playout, index, index * FRAME_S + transit_s)
        playout.sample_at(index * FRAME_S + transit_s + playout.config.floor_s + TICK_S)


def test_nothing_is_shown_before_the_first_frame_is_due() -> None:
    playout = Playout(PlayoutConfig(floor_s=0.01))
    assert playout.sample_at(0.0) is None
    receive(playout, 0, now=1.0)
    assert playout.sample_at(1.005) is None
    assert value_of(shown(playout, 1.011)) == 0


def test_on_a_perfect_network_the_delay_is_the_floor() -> None:
    playout = Playout(PlayoutConfig(floor_s=0.004))
    steady(playout, 100)
    assert playout.report().delay_s == pytest.approx(0.004, abs=TICK_S)
    assert playout.report().interval_s == pytest.approx(FRAME_S, rel=1e-3)


def test_the_delay_follows_the_jitter_up_and_down_again() -> None:
    playout = Playout(PlayoutConfig(floor_s=0.004, window_frames=60))
    for index in range(120):
        receive(playout, index, index * FRAME_S + 0.01 + (0.05 if index % 2 else 0.0))
    assert playout.report().delay_s == pytest.approx(0.054, abs=TICK_S)
    for index in range(120, 180):
        receive(playout, index, index * FRAME_S + 0.01)
    assert playout.report().delay_s == pytest.approx(0.004, abs=TICK_S)


def test_the_delay_never_exceeds_the_ceiling() -> None:
    playout = Playout(PlayoutConfig(ceiling_s=0.1))
    for index in range(60):
        receive(playout, index, index * FRAME_S + (0.9 if index % 2 else 0.0))
    assert playout.report().delay_s == pytest.approx(0.1)


def test_a_rare_late_frame_does_not_slow_the_others() -> None:
    playout = Playout(PlayoutConfig(floor_s=0.004))
    for index in range(100):
        receive(playout, index, index * FRAME_S + (0.3 if index == 50 else 0.01))
    assert playout.report().delay_s == pytest.approx(0.004, abs=TICK_S)


def test_between_two_frames_latent_and_head_are_interpolated() -> None:
    playout = Playout(PlayoutConfig(floor_s=0.05))
    playout.receive_frame(0, captured(0), sample(0.0, yaw=0.0), 0.0)
    playout.receive_frame(1, captured(1), sample(1.0, yaw=0.6), FRAME_S)
    face = shown(playout, 0.05 + 0.25 * FRAME_S)
    assert value_of(face) == pytest.approx(0.25, abs=1e-3)
    assert face.sample.rotation == pytest.approx([0, 0.15, 0], abs=1e-3)
    assert face.sample.translation_m[0] == pytest.approx(0.25, abs=1e-3)
    assert face.captured_us == pytest.approx(captured(0.25), abs=40)


def test_a_held_face_names_its_frame_and_counts_as_concealed_once_overdue() -> None:
    playout = Playout()
    steady(playout, 10)
    newest_s = 9 * FRAME_S
    fresh = shown(playout, newest_s + 0.02)
    assert (fresh.captured_us, fresh.is_concealed) == (captured(9), False)
    held = shown(playout, newest_s + 0.014 + 1.6 * FRAME_S)
    assert (held.captured_us, held.is_concealed) == (captured(9), True)
    assert held.age_s == pytest.approx(0.004 + 1.6 * FRAME_S, abs=1e-4)
    assert playout.report().concealed == 1


def test_frames_are_shown_in_capture_order_after_reordering() -> None:
    playout = Playout(PlayoutConfig(floor_s=0.1))
    for index in (0, 2, 1, 3):
        receive(playout, index, now=0.09)
    released = [frame.sequence for frame in playout.due_frames(10.0)]
    assert released == [0, 1, 2, 3]


def test_every_frame_comes_once_and_not_before_it_is_due() -> None:
    playout = Playout(PlayoutConfig(floor_s=0.005))
    receive(playout, 0, now=0.010)
    receive(playout, 1, now=0.010 + FRAME_S)
    assert playout.next_timer() == pytest.approx(0.015, abs=TICK_S)
    assert playout.due_frames(0.0149) == []
    timer = playout.next_timer()
    assert timer is not None
    assert [frame.sequence for frame in playout.due_frames(timer)] == [0]
    assert playout.due_frames(timer) == []
    assert [frame.sequence for frame in playout.due_frames(timer + FRAME_S + TICK_S)] == [1]
    assert playout.next_timer() is None


def test_a_frame_later_than_the_face_is_dropped_and_counted() -> None:
    playout = Playout()
    receive(playout, 0, 0.01)
    receive(playout, 2, 0.01 + 2 * FRAME_S)
    assert value_of(shown(playout, 1.0)) == 2
    receive(playout, 1, 1.1)
    assert value_of(shown(playout, 1.2)) == 2
    report = playout.report()
    assert (report.lost, report.late) == (1, 1)


def test_a_duplicate_is_counted_and_not_shown_again() -> None:
    playout = Playout(PlayoutConfig(floor_s=0.1))
    receive(playout, 0, 0.0)
    receive(playout, 0, 0.01)
    assert len(playout.due_frames(1.0)) == 1
    receive(playout, 0, 1.01)
    assert playout.due_frames(2.0) == []
    assert playout.report().duplicates == 2


def test_the_sequence_wraps_without_a_hole() -> None:
    playout = Playout()
    for index in range(65_530, 65_545):
        receive(playout, index, index * FRAME_S)
        playout.sample_at(index * FRAME_S + 0.004)
    report = playout.report()
    assert (report.received, report.lost, report.restarts) == (15, 0, 0)
    assert value_of(shown(playout, 65_544 * FRAME_S + 0.01)) == 65_544


def test_holes_are_counted_as_lost_and_concealed_when_frames_are_taken_once() -> None:
    playout = Playout()
    for index in (0, 1, 5, 6):
        receive(playout, index, index * FRAME_S)
        playout.due_frames(index * FRAME_S + 0.01)
    assert (playout.report().lost, playout.report().concealed) == (3, 3)


def test_a_long_hole_is_held_and_not_slid_across() -> None:
    playout = Playout(PlayoutConfig(floor_s=1.0, ceiling_s=1.0, max_gap_s=0.25))
    receive(playout, 0, 0.0)
    receive(playout, 20, 20 * FRAME_S)
    assert value_of(shown(playout, 1.0 + 10 * FRAME_S)) == 0


@pytest.mark.parametrize("jump_s", [-3600.0, -2.0, 2.0, 3600.0])
def test_a_sender_whose_clock_jumps_plays_on_with_the_usual_delay(jump_s: float) -> None:
    playout = Playout()
    steady(playout, 60)
    for index in range(60, 120):
        now = index * FRAME_S + 0.01
        playout.receive_frame(
            index, captured(index) + round(jump_s * 1e6), sample(float(index)), now
        )
        assert value_of(shown(playout, now + 0.0041)) == index
    report = playout.report()
    assert (report.restarts, report.lost) == (1, 0)
    assert report.delay_s == pytest.approx(0.004, abs=TICK_S)


def test_a_sender_that_starts_anew_keeps_its_last_face_until_the_new_one_is_due() -> None:
    playout = Playout()
    for index in range(5000, 5010):
        receive(playout, index, index * FRAME_S)
    before = shown(playout, 5010 * FRAME_S)
    restart_s = 5020 * FRAME_S
    playout.receive_frame(0, 77, sample(-1.0), restart_s)
    held = shown(playout, restart_s + 0.001)
    assert value_of(held) == value_of(before) == 5009
    assert held.is_concealed
    assert value_of(shown(playout, restart_s + 0.005)) == -1
    assert playout.report().restarts == 1


def test_a_sequence_that_falls_back_while_the_clock_goes_on_is_a_new_beginning() -> None:
    playout = Playout()
    steady(playout, 60)
    for index in range(60, 70):
        now = index * FRAME_S + 0.01
        playout.receive_frame(index - 60, captured(index), sample(float(index)), now)
        assert value_of(shown(playout, now + 0.0041)) == index
    assert (playout.report().restarts, playout.report().late) == (1, 0)


def test_a_stall_is_no_clock_jump_and_the_delay_recovers_after_it() -> None:
    playout = Playout()
    steady(playout, 60)
    for index in range(60, 150):  # three seconds behind one retransmission, then all at once
        receive(playout, index, 150 * FRAME_S)
        playout.sample_at(150 * FRAME_S)
    for index in range(150, 450):
        receive(playout, index, index * FRAME_S + 0.01)
        playout.sample_at(index * FRAME_S + 0.01)
    report = playout.report()
    assert report.restarts == 0
    assert report.delay_s == pytest.approx(0.004, abs=TICK_S)


def test_a_drifting_clock_is_followed() -> None:
    playout = Playout()
    for index in range(30 * 300):  # five minutes at +200 ppm: 60 ms in all
        playout.receive_frame(
            index % 65536, captured(index * (1 + 200e-6)), sample(), index * FRAME_S + 0.01
        )
        playout.sample_at(index * FRAME_S + 0.02)
    # The window spans 8.5 s, 1.7 ms of drift.
    assert playout.report().delay_s <= 0.004 + 0.0018
    assert playout.report().concealed == 0


def test_the_display_never_goes_back_when_the_delay_grows() -> None:
    playout = Playout(PlayoutConfig(floor_s=0.0))
    positions = []
    for index in range(200):
        now = index * FRAME_S + (0.08 if index > 60 and index % 3 == 0 else 0.01)
        receive(playout, index, now)
        positions += [shown(playout, now + step * 0.01).captured_us for step in range(1, 3)]
    assert positions == sorted(positions)


def test_the_buffer_is_bounded_and_drops_its_oldest() -> None:
    playout = Playout(PlayoutConfig(max_frames=8, floor_s=5.0, ceiling_s=5.0))
    for index in range(50):
        receive(playout, index, index * FRAME_S)
    assert playout.num_waiting == 8
    assert [frame.sequence for frame in playout.due_frames(100.0)] == list(range(42, 50))


def test_a_stream_that_never_sent_reports_zeros() -> None:
    report = Playout().report()
    assert (report.received, report.lost, report.delay_s, report.interval_s) == (0, 0, 0, 0)


@pytest.mark.parametrize(
    ("field", "value"),
    [("floor_s", 0.3), ("floor_s", -0.1), ("jitter_quantile", 0.0), ("max_frames", 1)],
)
def test_a_setting_out_of_range_is_named(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=field):
        PlayoutConfig(**{field: value})  # type: ignore[arg-type]


def test_rotations_blend_along_the_shorter_way() -> None:
    before = np.array([0, 3.0, 0], np.float32)
    after = np.array([0, -3.0, 0], np.float32)
    middle = blend_rotations(before, after, 0.5)
    assert abs(middle[1]) == pytest.approx(math.pi, abs=1e-5)
    for weight, end in ((0.0, before), (1.0, after)):
        assert blend_rotations(before, end, weight) == pytest.approx(end, abs=1e-6)


class PlayoutAgainstReference(RuleBasedStateMachine):
    """A network that delays, reorders, drops and repeats, and a reference that forgets nothing."""

    def __init__(self) -> None:
        super().__init__()
        self.config = PlayoutConfig(window_frames=8, max_frames=1000, ceiling_s=0.1)
        self.playout = Playout(self.config)
        self.now = 0.0
        self.next_index = 65_500  # so that the wrap comes soon
        self.under_way: list[int] = []
        self.arrivals: list[tuple[int, float]] = []  # first arrivals that were not late
        self.released: list[int] = []

    def captured_s(self, index: int) -> float:
        return captured(index - 65_500) / 1e6

    @rule(step_s=st.floats(0.0, 0.2))
    def time_passes(self, step_s: float) -> None:
        self.now += step_s

    @rule()
    def a_frame_is_captured(self) -> None:
        self.now = max(self.now, (self.next_index - 65_500) * FRAME_S)
        self.under_way.append(self.next_index)
        self.next_index += 1

    @rule(skipped=st.integers(1, 5))
    def frames_are_dropped(self, skipped: int) -> None:
        self.next_index += skipped

    @precondition(lambda self: self.under_way)
    @rule(data=st.data(), stays=st.booleans())
    def a_frame_arrives(self, data: st.DataObject, stays: bool) -> None:
        index = data.draw(st.sampled_from(self.under_way))
        if not stays:  # what stays under way arrives again
            self.under_way.remove(index)
        self.playout.receive_frame(
            index % 65536, captured(index - 65_500), sample(float(index)), self.now
        )
        known = {other for other, _ in self.arrivals}
        if index not in known and index > max(self.released, default=-1):
            self.arrivals.append((index, self.now))

    @rule()
    def what_is_due_is_taken(self) -> None:
        taken = [int(frame.sample.latent[0, 0, 0]) for frame in self.playout.due_frames(self.now)]
        transits = sorted(
            at - self.captured_s(index) for index, at in self.arrivals[-self.config.window_frames :]
        )
        expected = []
        if transits:
            rank = math.ceil(self.config.jitter_quantile * len(transits)) - 1
            delay = min(self.config.floor_s + transits[rank] - transits[0], self.config.ceiling_s)
            expected = sorted(
                index
                for index, _ in self.arrivals
                if index not in self.released
                and self.captured_s(index) + transits[0] + delay <= self.now
            )
        assert taken == expected
        self.released += taken

    @invariant()
    def frames_come_once_and_in_order(self) -> None:
        assert self.released == sorted(set(self.released))


TestPlayoutAgainstReference = PlayoutAgainstReference.TestCase
TestPlayoutAgainstReference.settings = settings(
    max_examples=60, stateful_step_count=40, deadline=None, derandomize=True
)
