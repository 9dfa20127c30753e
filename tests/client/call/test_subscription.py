"""Subscriptions to a share of a stream: up at once, down late, never more than a few messages."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.senders import LoadedAvatars
from helpers.toy import make_toy_avatar, toy_payload
from pica_client.call.participant import LOWER_INTERVAL_S, Participant
from pica_client.call.roster import Member
from pica_protocol.frames import Frame
from pica_protocol.messages import SHARES, Peer, Subscribe, Track

pytestmark = pytest.mark.unit

FACE = toy_payload()
TRACK = Track(kind="face", avatar="1" * 64, stream=1)


def make_participant() -> Participant:
    member = Member(peer=Peer(peer_id="ada", name="Ada", tracks=(TRACK,)), place=0)
    return Participant(member, TRACK)


def told(participant: Participant, now: float, *, can_tell: bool = True) -> int | None:
    """What the relay is told now."""
    said = []

    def tell(message: Subscribe) -> bool:
        said.append(message.every)
        return can_tell

    participant.tell_subscription(tell, now)
    return said[0] if said else None


def test_a_relay_that_was_told_nothing_sends_everything() -> None:
    ada = make_participant()
    ada.subscribe(1, now=0.0)
    assert told(ada, 0.0) is None


def test_less_is_asked_for_late_and_more_at_once() -> None:
    ada = make_participant()
    ada.subscribe(0, now=10.0)
    assert told(ada, 10.4) is None
    assert told(ada, 10.5) == 0
    ada.subscribe(2, now=10.51)
    assert told(ada, 10.51) == 2
    ada.subscribe(1, now=10.52)
    assert told(ada, 10.52) == 1


def test_a_glance_aside_tells_nothing() -> None:
    ada = make_participant()
    ada.subscribe(0, now=0.0)
    ada.subscribe(1, now=0.4)
    assert told(ada, 5.0) is None


def test_a_stream_that_is_not_wanted_is_not_stale_and_has_two_seconds_once_it_is() -> None:
    ada = make_participant()
    ada.last_arrival_s = 0.0
    ada.subscribe(0, now=0.0)
    assert told(ada, 0.5) == 0
    assert not ada.is_stale(60.0)
    ada.subscribe(1, now=60.0)
    assert told(ada, 60.0) == 1
    assert not ada.is_stale(61.9)
    assert ada.is_stale(62.1)


@pytest.mark.parametrize(("every", "expected"), [(0, 0), (2, 2), (1, None)])
def test_a_new_connection_is_told_at_once_if_less_is_wanted(
    every: int, expected: int | None
) -> None:
    ada = make_participant()
    ada.subscribe(every, now=0.0)
    told(ada, 0.5)
    ada.join_again(now=20.0)
    assert told(ada, 20.0) == expected


def test_a_face_whose_stream_was_stopped_stands_still_until_its_next_frame() -> None:
    ada, avatars = make_participant(), LoadedAvatars({TRACK.avatar: make_toy_avatar()})
    found = []
    for number, every in enumerate((1, 0, 1)):
        ada.subscribe(every, now=10.0 * number)
        told(ada, 10.0 * number + 1)
        for moment in (2, 3):  # while nothing is wanted these were under way
            captured_us = 1_000_000 * (10 * number + moment)
            frame = Frame(
                stream=1, sequence=2 * number + moment, captured_us=captured_us, payload=FACE
            )
            ada.receive_frame(frame, captured_us / 1e6, avatars)
        played, is_held = ada.play(10.0 * number + 4)
        assert played is not None
        found.append((played.captured_us // 1_000_000, is_held))
    assert found == [(3, False), (3, True), (23, False)]


shares = st.sampled_from(sorted(SHARES))
steps = st.lists(st.tuples(st.floats(0, 0.4), shares, st.booleans()), min_size=1, max_size=120)


@given(steps)
def test_the_relay_hears_the_last_wish_and_is_told_less_once_a_second_at_most(
    chosen: list[tuple[float, int, bool]],
) -> None:
    ada, now, lowered = make_participant(), 0.0, []
    rates = {0: 0.0, 1: 1.0, 2: 0.5, 4: 0.25}
    for elapsed_s, every, can_tell in [*chosen, *[(0.3, chosen[-1][1], True)] * 6]:
        now += elapsed_s
        before = ada.told
        ada.subscribe(every, now)
        told(ada, now, can_tell=can_tell)
        if rates[ada.told] < rates[before]:
            lowered.append(now)
        assert not can_tell or rates[ada.told] >= rates[every]  # never less than is wanted
    assert ada.told == chosen[-1][1]
    assert all(after - before >= LOWER_INTERVAL_S - 1e-9 for before, after in pairwise(lowered))
