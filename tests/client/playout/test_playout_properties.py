"""Whatever arrives: the display goes forwards, shows finite faces, in bounded steps and memory."""

from __future__ import annotations

import math
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from helpers.playout_trial import FAR_CLOCK_US, arrive, face, value_of
from pica_client.playout import buffer
from pica_client.playout.buffer import PlayedFace, Playout
from pica_client.playout.motion import MAX_FRAMES, MAX_GAP_S

pytestmark = [pytest.mark.unit, pytest.mark.slow]

FRAME_S = 1 / 30
FIRST = 65_500
"""The first sequence: the wrap comes soon."""


def captured_us(index: int) -> int:
    return FAR_CLOCK_US + round((index - FIRST) * FRAME_S * 1e6)


class FacesOnTheDisplay(RuleBasedStateMachine):
    """A network that delays, drops and repeats the frames of a steady sender, against the plain
    interpolation of everything that came."""

    def __init__(self) -> None:
        super().__init__()
        with mock.patch.object(buffer, "BLEND_S", 0.0):
            self.playout = Playout()
        self.now = 0.0
        self.next_index = FIRST
        self.under_way: list[int] = []
        self.known: set[int] = set()
        self.last: PlayedFace | None = None

    @rule(step_s=st.floats(0.0, 0.2))
    def time_passes(self, step_s: float) -> None:
        self.now += step_s

    @rule(count=st.integers(1, 4))
    def frames_are_captured(self, count: int) -> None:
        self.under_way += range(self.next_index, self.next_index + count)
        self.next_index += count
        self.now = max(self.now, (self.next_index - 1 - FIRST) * FRAME_S)

    @rule(skipped=st.integers(1, 8))
    def frames_are_dropped(self, skipped: int) -> None:
        self.next_index += skipped

    @precondition(lambda self: self.under_way)
    @rule(again=st.booleans())
    def a_frame_arrives(self, again: bool) -> None:
        index = self.under_way.pop(0)
        for _ in range(1 + again):
            self.arrive(index)

    @precondition(lambda self: self.under_way)
    @rule()
    def all_arrive(self) -> None:
        for index in self.under_way:
            self.arrive(index)
        self.under_way = []

    def arrive(self, index: int) -> None:
        sample = face(self.value(index))
        arrive(self.playout, index, captured_us(index), sample, self.now)
        self.known.add(index)

    def value(self, index: int) -> float:
        """A face that goes to and fro, by at most 9 a second."""
        return ((index * 7) % 4) / 10

    @invariant()
    def what_waits_is_bounded(self) -> None:
        assert self.playout.num_waiting <= MAX_FRAMES

    @rule()
    def the_display_refreshes(self) -> None:
        played = self.playout.sample_at(self.now)
        if played is None:
            assert self.last is None
            return
        if self.last is not None:
            assert played.captured_us >= self.last.captured_us
        self.last = played
        assert self.playout.report().age_s >= -1e-6
        before = max(i for i in self.known if captured_us(i) <= played.captured_us)
        after = min((i for i in self.known if captured_us(i) > played.captured_us), default=None)
        if played.captured_us == captured_us(before):  # held, or going on a little
            assert abs(value_of(played) - self.value(before)) <= 9 / 30 + 0.01
            return
        assert after is not None
        assert not played.is_concealed
        gap_s = (after - before) * FRAME_S
        if gap_s <= MAX_GAP_S:
            share = (played.captured_us - captured_us(before)) / (gap_s * 1e6)
            path = self.value(before) + share * (self.value(after) - self.value(before))
            assert value_of(played) == pytest.approx(path, abs=1e-3)


FacesOnTheDisplay.TestCase.settings = settings(
    max_examples=60, stateful_step_count=40, deadline=None, derandomize=True
)
TestFacesOnTheDisplay = FacesOnTheDisplay.TestCase


def anything(bits: int) -> st.SearchStrategy[int]:
    """A number of some bits, more often near an end or near others."""
    top = 2**bits - 1
    return st.one_of(st.integers(0, top), st.sampled_from([0, 1, top // 2, top - 1, top]))


frames = st.tuples(
    st.floats(0, 0.1),
    st.one_of(anything(16), st.integers(0, 40)),
    st.one_of(anything(64), st.integers(10**9, 10**9 + 2_000_000)),
    st.floats(-12, 12, width=32),
    st.booleans(),
)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(arrivals=st.lists(frames, max_size=60))
def test_no_arrival_whatever_breaks_the_buffer(
    arrivals: list[tuple[float, int, int, float, bool]],
) -> None:
    playout, now = Playout(), 100.0
    for step_s, sequence, captured, value, is_still in arrivals:
        now += step_s
        sample = face(value, yaw=value / 4, is_still=is_still)
        arrive(playout, sequence, captured, sample, now)
        if (played := playout.sample_at(now)) is not None:
            assert np.isfinite(played.sample.latent).all()
            assert np.isfinite(played.sample.rotation).all()
            assert np.isfinite(played.sample.translation_m).all()
            assert np.abs(played.sample.latent).max() <= 100
            assert math.isfinite(playout.report().age_s)
        assert playout.num_waiting <= MAX_FRAMES
    report = playout.report()
    assert report.received == len(arrivals)
    assert 0 <= report.concealed_ratio <= 1
