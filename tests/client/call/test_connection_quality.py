"""Warnings about connections: only for what is seen, and without flickering."""

from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_client.call.connection_quality import (
    BETTER_AFTER_S,
    WORSE_AFTER_S,
    Quality,
    QualityMeter,
    own_quality,
)
from pica_client.playout.buffer import PlayoutReport

pytestmark = pytest.mark.unit

STEP_S = 0.5


class Stream:
    """Counters that grow by thirty frames a second, of which some are lost or late."""

    def __init__(self) -> None:
        self.meter, self.now, self.health = QualityMeter(), 0.0, PlayoutReport()

    def run(self, seconds: float, *, lost: float = 0.0, missed: float = 0.0) -> list[Quality]:
        levels = []
        for _ in range(round(seconds / STEP_S)):
            self.now += STEP_S
            self.health = PlayoutReport(
                received=self.health.received + round(15 * (1 - lost)),
                missed_s=self.health.missed_s + STEP_S * missed,
            )
            levels.append(self.meter.receive(self.health, self.now))
        return levels


def test_a_clean_stream_is_good_from_the_start_and_a_hiccup_causes_no_warning() -> None:
    stream = Stream()
    assert set(stream.run(10)[4:]) == {"good"}
    assert "poor" not in stream.run(0.5, missed=0.4) + stream.run(10)


def test_frames_that_a_late_sender_leaves_out_are_no_fault_of_the_network() -> None:
    assert "poor" not in Stream().run(20, lost=0.3)


def test_lasting_trouble_is_poor_and_clears_with_patience() -> None:
    stream = Stream()
    stream.run(10)
    bad, after = stream.run(8, missed=0.4), stream.run(20)
    assert (bad[0], bad[-1], after[0], after[-1]) == ("good", "poor", "poor", "good")
    assert after.index("good") * STEP_S >= BETTER_AFTER_S


def test_a_level_that_alternates_around_a_limit_does_not_flicker() -> None:
    stream = Stream()
    levels = stream.run(5)
    for _ in range(20):
        levels += stream.run(1.0, missed=0.08) + stream.run(1.0, missed=0.18)
    assert sum(before != after for before, after in pairwise(levels[4:])) <= 1


def test_a_stream_that_is_silent_or_not_watched_by_a_busy_machine_keeps_its_level() -> None:
    stream = Stream()
    stream.run(6)
    for _ in range(30):
        stream.now += STEP_S
        assert stream.meter.receive(stream.health, stream.now) == "good"
    for _ in range(10):  # what a busy machine counts is not judged, then or later
        stream.health = replace(stream.health, missed_s=stream.health.missed_s + STEP_S)
        assert stream.meter.skip() == "good"
    assert set(stream.run(10)) == {"good"}


def test_a_stream_that_begins_again_or_is_muted_is_judged_anew() -> None:
    stream = Stream()
    stream.run(10)
    stream.health = PlayoutReport()
    assert "poor" not in stream.run(10)
    stream.now += STEP_S
    assert stream.meter.pause() == "unknown"
    stream.health = replace(stream.health, missed_s=9.0)
    assert "poor" not in stream.run(10)


healths = st.builds(PlayoutReport, received=st.integers(0, 10_000), missed_s=st.floats(0, 100))


@given(st.lists(st.tuples(st.floats(0.01, 3), healths), max_size=60))
def test_no_warning_comes_or_goes_faster_than_it_may(
    told: list[tuple[float, PlayoutReport]],
) -> None:
    meter, now, changed_s, level = QualityMeter(), 0.0, 0.0, "unknown"
    for wait_s, health in told:
        now += wait_s
        found = meter.receive(health, now)
        if found != level:
            if level != "unknown":
                patience_s = BETTER_AFTER_S if level == "poor" else WORSE_AFTER_S
                assert now - changed_s >= patience_s - 1e-9
            level, changed_s = found, now


@pytest.mark.parametrize(
    ("peers", "sent", "expected"),
    [
        ([], "unknown", "unknown"),
        (["poor"], "unknown", "good"),  # one of one may as well be theirs
        (["poor", "poor", "good"], "unknown", "poor"),
        (["poor", "good", "good"], "unknown", "good"),
        (["poor", "poor", "unknown"], "unknown", "poor"),
        (["good", "good"], "poor", "poor"),
    ],
)
def test_ones_own_connection_is_poor_when_most_streams_are_or_frames_cannot_be_sent(
    peers: list[Quality], sent: Quality, expected: Quality
) -> None:
    assert own_quality(peers, sent) == expected
