"""Faces make room for voices: at a standing queue, not at jitter, and come back by and by."""

import numpy as np
import pytest

from pica_client.call.layer_subscription import NOTHING, LayerSubscription
from pica_client.call.yielding import (
    LATE_S,
    MAX_STREAMS,
    MIN_PATIENCE_S,
    SETTLE_S,
    WINDOW_S,
    YieldingFaces,
)
from pica_protocol.limits import MAX_LAYER

pytestmark = pytest.mark.unit

PACKET_S, CLOCK_S = 0.04, 5000.0


class Way:
    """Brings a packet each 40 ms, so late as it is told."""

    def __init__(self) -> None:
        self.faces, self.now = YieldingFaces(), 0.0

    def run(self, seconds: float, *late_s: float) -> list[int]:
        """The layers that there was room for, each once in a row."""
        layers = [self.faces.max_layer]
        for index in range(round(seconds / PACKET_S)):
            self.now += PACKET_S
            captured_us = round((self.now + CLOCK_S) * 1e6)
            self.faces.receive("ada", captured_us, self.now + late_s[index % len(late_s)])
            if self.faces.max_layer != layers[-1]:
                layers.append(self.faces.max_layer)
        return layers


def test_a_standing_queue_leaves_the_lowest_layer_and_one_that_stays_no_face() -> None:
    way = Way()
    assert way.run(2.0, 0.0) == [MAX_LAYER]
    assert way.run(2 * WINDOW_S + 0.1, 0.2) == [MAX_LAYER, 0]
    assert way.run(SETTLE_S + 2 * WINDOW_S, 0.2) == [0, NOTHING]


def test_a_queue_that_drains_costs_no_more_than_it_must() -> None:
    way = Way()
    way.run(2.0, 0.0)
    way.run(1.0, 0.3)
    falling = [0.3 * 0.95**step for step in range(90)]
    assert way.run(90 * PACKET_S, *falling) == [0]


def test_jitter_is_no_queue() -> None:
    way = Way()
    late_s = np.random.default_rng(0).exponential(LATE_S / 3, 500)
    assert way.run(20.0, *map(float, late_s)) == [MAX_LAYER]


def test_a_clock_that_stood_still_while_its_machine_slept_is_no_queue() -> None:
    way = Way()
    way.run(2.0, 0.0)
    assert way.run(20.0, 10.0) == [MAX_LAYER]
    assert way.run(1.0, 10.2) == [MAX_LAYER, 0]


def test_a_microphone_that_is_slower_than_the_one_before_is_no_queue_for_long() -> None:
    way = Way()
    way.run(30.0, 0.0)
    assert way.run(4 * SETTLE_S + MIN_PATIENCE_S, 0.12) == [MAX_LAYER, 0, NOTHING, 0]


def test_a_queue_that_drains_slowly_once_faces_have_made_way_is_one() -> None:
    way = Way()
    way.run(2.0, 0.0)
    assert way.run(SETTLE_S + 2 * WINDOW_S, 0.3) == [MAX_LAYER, 0, NOTHING]
    assert way.run(11.0, *np.linspace(0.3, 0.05, round(11.0 / PACKET_S)).tolist()) == [NOTHING]


def test_layers_come_back_one_by_one_and_later_where_one_was_too_many() -> None:
    way = Way()
    way.run(2.0, 0.0)
    way.run(3.0, 0.2)
    assert way.run(3 * MIN_PATIENCE_S + 3, 0.0) == [NOTHING, 0, 1, MAX_LAYER]
    way.run(1.0, 0.2)
    assert way.run(MIN_PATIENCE_S + 3, 0.0) == [0]
    assert way.run(MIN_PATIENCE_S, 0.0) == [0, 1]


def test_strangers_who_come_and_go_fill_no_memory() -> None:
    faces = YieldingFaces()
    for index in range(5 * MAX_STREAMS):
        faces.receive(f"p{index}", 0, 0.01 * index)
    assert len(faces._fastest) <= MAX_STREAMS


def test_a_limit_holds_at_once_whatever_is_asked_for_and_ends_as_soon() -> None:
    subscription = LayerSubscription()
    subscription.limit(0, 1.0)
    assert subscription.due(1.0) == 0
    subscription.note_told(0, 1.0)
    subscription.subscribe(2, 1.1)
    assert subscription.due(5.0) is None
    assert not subscription.is_pushed_out
    subscription.limit(NOTHING, 6.0)
    assert subscription.due(6.0) == NOTHING
    assert subscription.is_pushed_out
    subscription.note_told(NOTHING, 6.0)
    subscription.limit(MAX_LAYER, 7.0)
    assert subscription.due(7.0) == 2
