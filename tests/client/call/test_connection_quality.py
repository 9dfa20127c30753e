"""Warnings about connections: only for what is seen, and without flickering."""

from __future__ import annotations

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
    StreamHealth,
    own_quality,
    quality_between,
)

pytestmark = pytest.mark.unit

STEP_S = 0.5


class Stream:
    """Counters that grow by thirty frames a second, some of them lost."""

    def __init__(self) -> None:
        self.meter = QualityMeter()
        self.now = 0.0
        self.health = StreamHealth()

    def run(self, seconds: float, *, lost: float = 0.0, age_s: float = 0.1) -> list[Quality]:
        levels = []
        for _ in range(round(seconds / STEP_S)):
            self.now += STEP_S
            before = self.health
            num_lost = round(15 * lost)
            self.health = StreamHealth(
                received=before.received + 15 - num_lost,
                lost=before.lost + num_lost,
                shown=before.shown + 30,
                concealed=before.concealed + num_lost,
                age_s=age_s,
            )
            levels.append(self.meter.receive(self.health, self.now))
        return levels


def test_a_clean_stream_is_good_from_the_start() -> None:
    assert set(Stream().run(20)[1:]) == {"good"}


def test_a_hiccup_is_not_worth_a_warning() -> None:
    stream = Stream()
    levels = stream.run(10) + stream.run(0.5, lost=0.4) + stream.run(10)
    assert "poor" not in levels


def test_lasting_loss_is_poor_and_clears_with_patience() -> None:
    stream = Stream()
    stream.run(10)
    bad = stream.run(8, lost=0.3)
    assert bad[0] == "good"
    assert bad[-1] == "poor"
    after = stream.run(20)
    assert after[0] == "poor"
    assert after[-1] == "good"
    assert after.index("good") * STEP_S >= BETTER_AFTER_S


def test_an_old_face_is_poor_without_any_loss() -> None:
    stream = Stream()
    stream.run(5)
    assert stream.run(5, age_s=0.8)[-1] == "poor"


def test_a_level_that_alternates_around_a_limit_does_not_flicker() -> None:
    stream = Stream()
    levels = stream.run(5)
    for _ in range(20):
        levels += stream.run(1.0, age_s=0.24) + stream.run(1.0, age_s=0.26)
    changes = sum(before != after for before, after in pairwise(levels[1:]))
    assert changes <= 1


def test_a_silent_stream_keeps_its_level() -> None:
    stream = Stream()
    stream.run(6)
    for _ in range(30):
        stream.now += STEP_S
        assert stream.meter.receive(stream.health, stream.now) == "good"


def test_a_stream_that_begins_anew_is_judged_anew() -> None:
    stream = Stream()
    stream.run(10)
    stream.health = StreamHealth()
    assert "poor" not in stream.run(10)


def test_a_stream_that_is_muted_is_not_poor_for_it() -> None:
    stream = Stream()
    stream.run(10)
    for _ in range(10):
        stream.now += STEP_S
        health = replace(stream.health, shown=stream.health.shown + 30, age_s=4.0, is_paused=True)
        assert stream.meter.receive(health, stream.now) == "unknown"
    assert "poor" not in stream.run(10)


def test_a_machine_that_draws_seldom_does_not_blame_the_network() -> None:
    seldom = StreamHealth(received=120, lost=60, shown=9, concealed=5, age_s=0.7)
    often = StreamHealth(received=120, shown=120, concealed=60, age_s=0.1)
    assert quality_between(StreamHealth(), seldom) == "unknown"
    assert quality_between(StreamHealth(), often) == "poor"


def test_nothing_known_is_unknown() -> None:
    assert quality_between(StreamHealth(), StreamHealth()) == "unknown"
    assert QualityMeter().level == "unknown"


counters = st.integers(0, 10_000)
healths = st.builds(
    StreamHealth,
    received=counters,
    lost=counters,
    late=counters,
    shown=counters,
    concealed=counters,
    age_s=st.floats(0, 100),
)


@given(st.lists(st.tuples(st.floats(0.01, 3), healths), max_size=60))
def test_no_warning_comes_or_goes_faster_than_it_may(
    told: list[tuple[float, StreamHealth]],
) -> None:
    meter, now, changed_s, level = QualityMeter(), 0.0, 0.0, "unknown"
    for wait_s, health in told:
        now += wait_s
        found = meter.receive(health, now)
        if found != level:
            if level != "unknown":
                assert now - changed_s >= WORSE_AFTER_S - 1e-9
                if level == "poor":
                    assert now - changed_s >= BETTER_AFTER_S - 1e-9
            level, changed_s = found, now


@pytest.mark.parametrize(
    ("peers", "expected"),
    [
        ([], "unknown"),
        (["poor"], "good"),  # one of one may as well be theirs
        (["poor", "poor"], "poor"),
        (["poor", "poor", "good"], "poor"),
        (["poor", "good", "good"], "good"),
        (["poor", "poor", "unknown"], "poor"),
    ],
)
def test_ones_own_connection_is_poor_when_most_streams_are(
    peers: list[Quality], expected: Quality
) -> None:
    assert own_quality(peers) == expected


def test_frames_that_cannot_be_sent_make_ones_own_connection_poor() -> None:
    assert own_quality(["good", "good"], replaced_ratio=0.5) == "poor"
    assert own_quality(["good", "good"], replaced_ratio=0.01) == "good"
