"""Subscriptions to layers: up at once, down late, never more than a few messages."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_client.call.layer_subscription import LOWER_INTERVAL_S, NOTHING, LayerSubscription
from pica_protocol.limits import MAX_LAYER

pytestmark = pytest.mark.unit


def tell(subscription: LayerSubscription, now: float) -> int | None:
    """What the relay is told now."""
    layer = subscription.due(now)
    if layer is not None:
        subscription.note_told(layer, now)
    return layer


def test_a_relay_that_was_told_nothing_sends_everything() -> None:
    made = LayerSubscription()
    assert made.told == MAX_LAYER
    assert not made.subscribe(MAX_LAYER, now=0.0)
    assert made.due(0.0) is None
    assert made.next_timer() is None


def test_less_is_asked_for_late() -> None:
    made = LayerSubscription()
    assert made.subscribe(None, now=10.0)
    assert tell(made, 10.4) is None
    assert made.next_timer() == 10.5
    assert tell(made, 10.5) == NOTHING
    assert made.told == NOTHING
    assert made.next_timer() is None


def test_more_is_asked_for_at_once() -> None:
    made = LayerSubscription()
    made.subscribe(None, now=0.0)
    tell(made, 0.5)
    assert made.subscribe(2, now=0.51)
    assert tell(made, 0.51) == 2
    made.subscribe(3, now=0.52)
    assert tell(made, 0.52) == 3


def test_a_glance_aside_tells_nothing() -> None:
    made = LayerSubscription()
    made.subscribe(None, now=0.0)
    made.subscribe(MAX_LAYER, now=0.4)
    assert tell(made, 5.0) is None
    assert made.next_timer() is None


def test_what_was_wanted_meanwhile_is_not_taken_away() -> None:
    made = LayerSubscription()
    made.subscribe(0, now=0.0)
    made.subscribe(2, now=0.3)
    made.subscribe(1, now=0.4)
    assert tell(made, 0.5) == 2
    assert tell(made, 1.4) is None
    assert tell(made, 1.5) == 1


def test_what_could_not_be_told_stays_due() -> None:
    made = LayerSubscription()
    made.subscribe(None, now=0.0)
    assert made.due(0.5) == NOTHING
    assert made.told == MAX_LAYER
    assert tell(made, 2.0) == NOTHING
    made.subscribe(1, now=3.0)
    assert made.due(3.0) == 1
    assert tell(made, 3.1) == 1


@pytest.mark.parametrize(("layer", "told"), [(None, NOTHING), (1, 1), (MAX_LAYER, None)])
def test_a_new_connection_is_told_every_wish_for_less(layer: int | None, told: int | None) -> None:
    made = LayerSubscription()
    made.subscribe(layer, now=0.0)
    tell(made, 0.5)
    made.begin(now=20.0)
    assert made.told == MAX_LAYER
    assert tell(made, 20.0) == told


layers = st.one_of(st.none(), st.integers(0, MAX_LAYER))
steps = st.lists(st.tuples(st.floats(0, 0.4), layers, st.booleans()), min_size=1, max_size=120)


@given(steps)
def test_whatever_is_wanted_the_relay_hears_the_last_of_it_and_little_else(
    chosen: list[tuple[float, int | None, bool]],
) -> None:
    made, now, told, lowered = LayerSubscription(), 0.0, MAX_LAYER, []
    for elapsed_s, layer, can_tell in chosen:
        now += elapsed_s
        made.subscribe(layer, now)
        if can_tell and (said := tell(made, now)) is not None:
            if said < told:
                lowered.append(now)
            told = said
        assert made.told == told
        # Never less than is wanted.
        assert not can_tell or told >= (NOTHING if layer is None else layer)
    while (timer := made.next_timer()) is not None or made.due(now) is not None:
        now = max(now, timer or now)
        if (said := tell(made, now)) is not None:
            if said < told:
                lowered.append(now)
            told = said
    assert told == (NOTHING if chosen[-1][1] is None else chosen[-1][1])
    gaps = [after - before for before, after in pairwise(lowered)]
    assert all(gap >= LOWER_INTERVAL_S - 1e-9 for gap in gaps)
