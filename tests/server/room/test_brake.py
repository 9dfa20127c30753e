"""A relay with too much to do thins and refuses, and sends nobody away."""

from http import HTTPStatus

import pytest

from helpers.members import Member, hub_with
from pica_protocol.errors import CloseCode
from pica_protocol.frames import Frame
from pica_protocol.limits import MAX_LAYER
from pica_protocol.messages import KeyframeRequest
from pica_server.config.relay import RelayConfig
from pica_server.ops.status_pages import LoopWatch, StatusPages
from pica_server.room.brake import (
    AMPLE_BUSY_RATIO,
    CALM_S,
    FULL_BUSY_RATIO,
    FULL_LATE_S,
    GATHER_BUSY_RATIO,
    GATHER_SPARE_RATIO,
    GATHER_SURE_S,
    LATE_S,
    LONGEST_CALM_S,
    SPARE_CALM_S,
    Brake,
)
from pica_server.room.hub import Hub

pytestmark = pytest.mark.unit

BUSY, SPARE = 0.95, 0.2


def turns(brake: Brake, begin_s: float, seconds: float, late_s: float, busy: float = BUSY) -> float:
    """Let a loop turn for a while, each turn so late; return when that ends."""
    now = begin_s
    while now < begin_s + seconds:
        now += 0.05 + late_s
        brake.note_turn(late_s, busy, now)
    return now


def test_a_pause_is_no_overload() -> None:
    brake = Brake()
    brake.note_turn(13.0, BUSY, now=13.0)
    brake.note_turn(0.3, BUSY, now=13.4)
    turns(brake, 13.4, 1.0, 0.0)
    assert brake.level == 0


def test_faces_gather_once_the_loop_has_been_busy_for_a_while() -> None:
    brake = Brake()
    turns(brake, 0.0, GATHER_SURE_S - 0.1, 0.0, GATHER_BUSY_RATIO)
    turns(brake, GATHER_SURE_S - 0.1, 0.2, 0.0, GATHER_BUSY_RATIO - 0.01)
    assert not brake.is_gathering  # a moment is not enough
    turns(brake, 10.0, GATHER_SURE_S + 0.1, 0.0, GATHER_BUSY_RATIO)
    assert brake.is_gathering
    assert brake.level == 0


def test_faces_gather_no_more_once_there_has_been_time_to_spare_for_a_while() -> None:
    brake = Brake()
    now = turns(brake, 0.0, GATHER_SURE_S + 0.1, 0.0, GATHER_BUSY_RATIO)
    now = turns(brake, now, 10.0, 0.0, GATHER_SPARE_RATIO)
    assert brake.is_gathering  # what gathering saves must not end it
    now = turns(brake, now, GATHER_SURE_S - 0.1, 0.0, GATHER_SPARE_RATIO - 0.01)
    assert brake.is_gathering
    turns(brake, now, 0.2, 0.0, GATHER_SPARE_RATIO - 0.01)
    assert not brake.is_gathering


def test_faces_do_not_gather_in_a_loop_that_is_late_as_others_have_the_core() -> None:
    brake = Brake()
    turns(brake, 0.0, 4 * GATHER_SURE_S, FULL_LATE_S, SPARE)
    assert brake.is_full
    assert not brake.is_gathering


def test_the_level_rises_while_turns_are_late_and_stays_when_they_get_better() -> None:
    brake = Brake()
    levels = []
    for late_s in (0.3, 0.3, 0.2, 0.1, 0.1, 0.1):
        brake.note_turn(late_s, BUSY, now=len(levels) * 0.3)
        levels.append((brake.level, brake.highest_layer))
    assert levels == [(0, MAX_LAYER), (1, 1), (1, 1), (1, 1), (2, 0), (2, 0)]


def test_faces_become_stills_only_when_very_late() -> None:
    brake = Brake()
    now = turns(brake, 0.0, 10.0, 3 * LATE_S)
    assert brake.level == 2
    turns(brake, now, 3.0, 6 * LATE_S)
    assert (brake.level, brake.highest_layer) == (3, -1)


def test_the_level_falls_step_by_step_in_calm_and_more_slowly_if_that_was_too_soon() -> None:
    brake = Brake()
    now = turns(brake, 0.0, 1.0, LATE_S)
    assert brake.level == 2
    now = turns(brake, now, CALM_S + 0.2, 0.0)
    assert brake.level == 1
    now = turns(brake, now, 0.5, LATE_S)
    assert brake.level == 2
    now = turns(brake, now, 2 * CALM_S - 0.2, 0.0)
    assert (brake.level, brake.retry_after_s) == (2, 2 * CALM_S)
    now = turns(brake, now, 4 * CALM_S + 1.0, 0.0)
    assert brake.level == 0
    turns(brake, now, LONGEST_CALM_S, 0.0)
    assert brake.retry_after_s == CALM_S


def test_a_loop_with_time_to_spare_lets_go_soon() -> None:
    brake = Brake()
    now = turns(brake, 0.0, 1.0, LATE_S)
    turns(brake, now, 2 * SPARE_CALM_S + 0.2, 0.0, SPARE)
    assert brake.level == 0


def test_a_core_is_full_from_a_busy_time_until_there_is_time_to_spare() -> None:
    brake = Brake()
    ratios = (0.9, FULL_BUSY_RATIO, 0.9, AMPLE_BUSY_RATIO, 0.7, 0.9)
    assert [full_after(brake, ratio) for ratio in ratios] == [False, True, True, True, False, False]
    assert full_after(brake, SPARE, FULL_LATE_S)


def full_after(brake: Brake, busy_ratio: float, late_s: float = 0.0) -> bool:
    brake.note_turn(late_s, busy_ratio, now=0.0)
    return brake.is_full


def braking(hub: Hub, level: int, now: float) -> None:
    """Make a hub brake that hard."""
    while hub.brake.level < level:
        hub.note_turn(1.0, 0.0, now)


def test_upper_layers_are_dropped_and_counted_and_none_comes_without_what_it_refers_to() -> None:
    hub = Hub(RelayConfig())
    ada, bob = Member(hub, "Ada"), Member(hub, "Bob")
    layers, heard = (0, 2, 1, 2), []
    for i in range(24):
        if i == 8:
            braking(hub, 2, now=i / 30)
        if i == 15:  # after a frame of layer 1 was dropped, before one of layer 2 that refers to it
            turns(hub.brake, i / 30, 2 * SPARE_CALM_S + 0.2, 0.0, SPARE)
        ada.send_frame(b"x", now=i / 30, layer=layers[i % 4], is_keyframe=i == 0)
        heard += bob.listen(now=i / 30)
    came = [each.sequence for each in heard if isinstance(each, Frame)]
    assert came == [*range(9), 12, *range(16, 24)]
    assert hub.stats.dropped == {"late": 24 - len(came)}


def test_of_a_relay_that_is_very_late_keyframes_come_and_are_asked_for_now_and_then() -> None:
    hub = Hub(RelayConfig())
    ada, bob = Member(hub, "Ada"), Member(hub, "Bob")
    heard, asked = [], []
    for i in range(90):
        if i == 10:
            braking(hub, 3, now=i / 30)
        if i == 75:
            turns(hub.brake, i / 30, 3 * SPARE_CALM_S + 0.5, 0.0, SPARE)
        ada.send_frame(b"x", now=i / 30, is_keyframe=i in (0, 30, 80))
        heard += bob.listen(now=i / 30)
        asked += [i for each in ada.listen(now=i / 30) if isinstance(each, KeyframeRequest)]
    came = [each.sequence for each in heard if isinstance(each, Frame)]
    assert came == [*range(10), 30, *range(80, 90)]
    assert asked == [10, 70]  # two seconds apart
    assert hub.stats.dropped == {"late": 90 - len(came)}


def test_who_comes_back_to_a_place_is_let_in_however_late_the_relay_is() -> None:
    hub, (ada, _bob) = hub_with("Ada", "Bob", resumable=True)
    ticket = ada.lose_connection(now=1.0)
    braking(hub, 2, now=1.0)
    again = Member(hub, "Ada", now=2.0, ticket=ticket, resumable=True)
    assert again.connection.closed is None
    assert again.peer_id == ada.peer_id


def test_who_joins_anew_is_told_to_come_later_and_the_pages_say_so() -> None:
    hub = Hub(RelayConfig())
    ada = Member(hub, "Ada")
    braking(hub, 1, now=1.0)
    bob = Member(hub, "Bob", now=1.0)
    assert ada.connection.closed is None
    assert bob.connection.closed is not None
    assert bob.connection.closed.code == CloseCode.BUSY
    assert "try again in 5 s" in bob.connection.closed.reason
    assert hub.stats.limits_hit == {"late": 1}
    pages = StatusPages(hub, LoopWatch(), RelayConfig())
    ready = pages.answer("/readyz", is_local=True, now=1.0)
    assert ready is not None
    assert ready.status == HTTPStatus.SERVICE_UNAVAILABLE
    assert ready.headers == {"Retry-After": f"{CALM_S:.0f}"}
    metrics = pages.answer("/metrics", is_local=True, now=1.0)
    assert metrics is not None
    assert "pica_brake_level 1.0\n" in metrics.text
    turns(hub.brake, 1.0, SPARE_CALM_S + 0.2, 0.0, SPARE)
    assert Member(hub, "Cleo", now=5.0).connection.closed is None
    ready = pages.answer("/readyz", is_local=True, now=5.0)
    assert ready is not None
    assert ready.status == HTTPStatus.OK
