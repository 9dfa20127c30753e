"""Whatever arrives: the display goes forwards, shows finite faces, in bounded steps and memory."""

import math
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.playout_trial import FAR_CLOCK_US, arrive, face, value_of
from pica_client.playout import buffer
from pica_client.playout.buffer import MAX_FRAMES, MAX_GAP_S, Playout

pytestmark = [pytest.mark.unit, pytest.mark.slow]

FRAME_S = 1 / 30
FIRST = 65_500
"""The first sequence: the wrap comes soon."""


def captured_us(index: int) -> int:
    return FAR_CLOCK_US + round((index - FIRST) * FRAME_S * 1e6)


def value(index: int) -> float:
    """A face that goes to and fro, by at most 9 a second."""
    return ((index * 7) % 4) / 10


steps = st.tuples(st.integers(1, 8), st.floats(0, 0.3), st.integers(1, 2), st.integers(0, 6))


@mock.patch.object(buffer, "BLEND_S", 0.0)
@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.lists(steps, max_size=60))
def test_a_face_moves_evenly_between_the_frames_that_came_and_never_back(
    stream: list[tuple[int, float, int, int]],
) -> None:
    """Frames some of which are left out, late, or come twice, and refreshes between them."""
    playout = Playout()
    now, index, last_us, known = 0.0, FIRST, 0, list[int]()
    for num_ahead, late_s, times, refreshes in stream:
        index += num_ahead
        now = max(now, (index - FIRST) * FRAME_S + late_s)
        for _ in range(times):
            arrive(playout, index, captured_us(index), face(value(index)), now)
        known.append(index)
        assert playout.num_waiting <= MAX_FRAMES
        for _ in range(refreshes):
            now += 0.02
            played = playout.sample_at(now)
            if played is None:
                continue
            assert played.captured_us >= last_us
            assert playout.report().age_s >= -1e-6
            last_us = played.captured_us
            before = max(i for i in known if captured_us(i) <= last_us)
            after = min((i for i in known if captured_us(i) > last_us), default=None)
            expected = value(before)
            if after is not None and (after - before) * FRAME_S <= MAX_GAP_S:
                share = (last_us - captured_us(before)) / ((after - before) * FRAME_S * 1e6)
                expected += share * (value(after) - value(before))
            if after is None or (after - before) * FRAME_S <= MAX_GAP_S:
                assert value_of(played) == pytest.approx(expected, abs=1e-3)


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
