"""Wishes for layers: up at once, down late, never more than a few messages."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_client.call.layer_subscription import (
    LayerSubscription,
    LayerSubscriptionConfig,
    LayerSubscriptions,
)
from pica_client.errors import OptionError
from pica_protocol.limits import MAX_LAYER

pytestmark = pytest.mark.unit

CONFIG = LayerSubscriptionConfig(lower_after_s=0.5, lower_interval_s=1.0)


def wishes() -> LayerSubscriptions:
    return LayerSubscriptions(CONFIG)


def test_a_relay_that_was_told_nothing_sends_everything() -> None:
    made = wishes()
    assert made.wants(1)
    assert not made.wish(1, MAX_LAYER, now=0.0)
    assert made.due(0.0) == []
    assert made.next_timer() is None


def test_a_wish_for_less_is_told_late() -> None:
    made = wishes()
    assert made.wish(1, None, now=10.0)
    assert made.due(10.4) == []
    assert made.next_timer() == 10.5
    assert made.due(10.5) == [LayerSubscription(1, None, is_resumption=False)]
    assert not made.wants(1)
    assert made.next_timer() is None


def test_a_wish_for_more_is_told_at_once() -> None:
    made = wishes()
    made.wish(1, None, now=0.0)
    made.due(0.5)
    assert made.wish(1, 2, now=0.51)
    assert made.due(0.51) == [LayerSubscription(1, 2, is_resumption=True)]
    made.wish(1, 3, now=0.52)
    assert made.due(0.52) == [LayerSubscription(1, 3, is_resumption=False)]


def test_a_glance_aside_tells_nothing() -> None:
    made = wishes()
    made.wish(1, None, now=0.0)
    made.wish(1, MAX_LAYER, now=0.4)
    assert made.due(5.0) == []
    assert made.next_timer() is None


def test_what_was_wished_meanwhile_is_not_taken_away() -> None:
    made = wishes()
    made.wish(1, 0, now=0.0)
    made.wish(1, 2, now=0.3)
    made.wish(1, 1, now=0.4)
    assert made.due(0.5) == [LayerSubscription(1, 2, is_resumption=False)]
    assert made.due(1.4) == []
    assert made.due(1.5) == [LayerSubscription(1, 1, is_resumption=False)]


def test_a_wish_that_could_not_be_told_is_due_again() -> None:
    made = wishes()
    made.wish(1, None, now=0.0)
    made.due(0.5)
    made.note_untold(1, now=0.5)
    assert made.wants(1)
    assert made.due(2.0) == [LayerSubscription(1, None, is_resumption=False)]
    made.wish(1, 1, now=3.0)
    assert made.due(3.0)
    made.note_untold(1, now=3.0)
    assert made.due(3.0) == [LayerSubscription(1, 1, is_resumption=True)]


def test_a_new_connection_is_told_all_wishes_for_less() -> None:
    made = wishes()
    for stream, layer in ((1, None), (2, 1), (3, MAX_LAYER)):
        made.wish(stream, layer, now=0.0)
    made.due(0.5)
    made.begin(now=20.0)
    assert made.wants(1)
    assert made.due(20.0) == [LayerSubscription(1, None, False), LayerSubscription(2, 1, False)]


def test_a_stream_that_ended_is_forgotten() -> None:
    made = wishes()
    made.wish(1, None, now=0.0)
    made.forget(1)
    made.forget(2)
    assert made.due(9.0) == []
    assert made.wants(1)


@pytest.mark.parametrize("name", ["lower_after_s", "lower_interval_s"])
def test_patience_out_of_range_is_refused(name: str) -> None:
    with pytest.raises(OptionError, match=f"{name} is -1"):
        LayerSubscriptionConfig(**{name: -1})


layers = st.one_of(st.none(), st.integers(0, MAX_LAYER))
steps = st.lists(st.tuples(st.floats(0, 0.4), layers), min_size=1, max_size=120)


@given(steps)
def test_whatever_is_wished_the_relay_hears_the_last_of_it_and_little_else(
    chosen: list[tuple[float, int | None]],
) -> None:
    made, now, told, lowered = wishes(), 0.0, MAX_LAYER, []
    rank = {None: -1}
    for elapsed_s, layer in chosen:
        now += elapsed_s
        made.wish(1, layer, now)
        for each in made.due(now):
            assert each.is_resumption == (told == -1)
            if rank.get(each.layer, each.layer) < told:
                lowered.append(now)
            told = rank.get(each.layer, each.layer)
        # Never less than is wished.
        assert told >= rank.get(layer, layer)
    while (timer := made.next_timer()) is not None:
        now = max(now, timer)
        for each in made.due(now):
            lowered.append(now)
            told = rank.get(each.layer, each.layer)
    assert told == rank.get(chosen[-1][1], chosen[-1][1])
    gaps = [after - before for before, after in pairwise(lowered)]
    assert all(gap >= CONFIG.lower_interval_s - 1e-9 for gap in gaps)
