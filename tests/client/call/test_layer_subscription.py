"""Subscriptions to layers: up at once, down late, never more than a few messages."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_client.call.layer_subscription import (
    ALL,
    EVERY,
    LOWER_INTERVAL_S,
    NOTHING,
    LayerSubscription,
)

pytestmark = pytest.mark.unit


def tell(subscription: LayerSubscription, now: float) -> int | None:
    """What the relay is told now."""
    share = subscription.due(now)
    if share is not None:
        subscription.note_told(share, now)
    return share


def test_a_relay_that_was_told_nothing_sends_everything() -> None:
    made = LayerSubscription()
    assert made.told == ALL
    assert not made.subscribe(1, now=0.0)
    assert made.due(0.0) is None
    assert made.next_timer() is None


def test_less_is_asked_for_late() -> None:
    made = LayerSubscription()
    assert made.subscribe(0, now=10.0)
    assert tell(made, 10.4) is None
    assert made.next_timer() == 10.5
    assert tell(made, 10.5) == NOTHING
    assert made.told == NOTHING
    assert made.next_timer() is None


def test_more_is_asked_for_at_once() -> None:
    made = LayerSubscription()
    made.subscribe(0, now=0.0)
    tell(made, 0.5)
    assert made.subscribe(2, now=0.51)
    assert tell(made, 0.51) == EVERY.index(2)
    made.subscribe(1, now=0.52)
    assert tell(made, 0.52) == ALL


def test_a_glance_aside_tells_nothing() -> None:
    made = LayerSubscription()
    made.subscribe(0, now=0.0)
    made.subscribe(1, now=0.4)
    assert tell(made, 5.0) is None
    assert made.next_timer() is None


def test_what_was_wanted_meanwhile_is_not_taken_away() -> None:
    made = LayerSubscription()
    made.subscribe(0, now=0.0)
    made.subscribe(2, now=0.3)
    made.subscribe(4, now=0.4)
    assert tell(made, 0.5) == EVERY.index(2)
    assert tell(made, 1.4) is None
    assert tell(made, 1.5) == EVERY.index(4)


def test_what_could_not_be_told_stays_due() -> None:
    made = LayerSubscription()
    made.subscribe(0, now=0.0)
    assert made.due(0.5) == NOTHING
    assert made.told == ALL
    assert tell(made, 2.0) == NOTHING
    made.subscribe(2, now=3.0)
    assert made.due(3.0) == EVERY.index(2)
    assert tell(made, 3.1) == EVERY.index(2)


@pytest.mark.parametrize(("every", "told"), [(0, NOTHING), (2, 2), (1, None)])
def test_a_new_connection_is_told_every_wish_for_less(every: int, told: int | None) -> None:
    made = LayerSubscription()
    made.subscribe(every, now=0.0)
    tell(made, 0.5)
    made.begin(now=20.0)
    assert made.told == ALL
    assert tell(made, 20.0) == told


shares = st.sampled_from(EVERY)
steps = st.lists(st.tuples(st.floats(0, 0.4), shares, st.booleans()), min_size=1, max_size=120)


@given(steps)
def test_whatever_is_wanted_the_relay_hears_the_last_of_it_and_little_else(
    chosen: list[tuple[float, int, bool]],
) -> None:
    made, now, told, lowered = LayerSubscription(), 0.0, ALL, []
    for elapsed_s, every, can_tell in chosen:
        now += elapsed_s
        made.subscribe(every, now)
        if can_tell and (said := tell(made, now)) is not None:
            if said < told:
                lowered.append(now)
            told = said
        assert made.told == told
        # Never less than is wanted.
        assert not can_tell or told >= EVERY.index(every)
    while (timer := made.next_timer()) is not None or made.due(now) is not None:
        now = max(now, timer or now)
        if (said := tell(made, now)) is not None:
            if said < told:
                lowered.append(now)
            told = said
    assert told == EVERY.index(chosen[-1][1])
    gaps = [after - before for before, after in pairwise(lowered)]
    assert all(gap >= LOWER_INTERVAL_S - 1e-9 for gap in gaps)
