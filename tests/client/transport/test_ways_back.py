"""The pure parts of finding the relay again: silence, addresses, refusals."""

from __future__ import annotations

import pytest

from pica_client.errors import OptionError, RelayRefusedError, RelayUnreachableError
from pica_client.transport.config import LinkConfig
from pica_client.transport.dialer import Addresses
from pica_client.transport.refusals import RETURN_S, Refusals, refusal_of
from pica_client.transport.silence import FORGET_S, GIVE_UP_S, QUIET_S, Silence
from pica_protocol.errors import CloseCode
from pica_protocol.session import Closed

pytestmark = pytest.mark.unit

FULL = RelayRefusedError("full", may_pass=True)


def watch(chance: float = 1.0) -> Silence:
    return Silence(lambda: chance)


def steps(silence: Silence, heard_s: float, until_s: float) -> list[tuple[str, float]]:
    """What is done until a moment when nothing is heard; every look fails at once."""
    done = []
    while (now := silence.next_timer(heard_s)) <= until_s:
        step = silence.handle_timer(heard_s, now)
        done.append((step, now))
        if step == "look":
            silence.note_failed(now)
        if step == "give up":
            break
    return done


def test_a_relay_that_is_heard_is_asked_nothing() -> None:
    silence = watch()
    for frame in range(100):
        heard_s = frame / 30
        assert silence.handle_timer(heard_s, heard_s + 1 / 30) == "wait"
        assert silence.next_timer(heard_s) == heard_s + QUIET_S


@pytest.mark.parametrize(("chance", "look_s"), [(0.0, 1.75), (1.0, 2.5)])
def test_another_way_is_looked_for_after_about_two_seconds_of_silence(
    chance: float, look_s: float
) -> None:
    assert steps(watch(chance), 0.0, 2.5)[:2] == [("ask", 1.0), ("look", look_s)]


def test_looks_become_rarer_and_end() -> None:
    done = steps(watch(), 0.0, 60.0)
    assert [step for step, _ in done] == ["ask", *["look"] * 6, "give up"]
    assert done[-1][1] == 1.0 + GIVE_UP_S


def test_who_slept_asks_before_it_looks_for_another_way() -> None:
    assert watch().handle_timer(0.0, 20.0) == "ask"


def test_an_answer_ends_it_and_a_quiet_room_is_asked_once_a_second() -> None:
    silence = watch()
    for second in range(1, 100):
        assert silence.handle_timer(second - 1.0, float(second)) == "ask"


def test_a_relay_that_was_only_busy_is_given_more_time_from_then_on_for_a_minute() -> None:
    silence, heard_s, waited_s = watch(), 0.0, []
    for _ in range(5):
        (_, asked_s), (_, look_s) = steps(silence, heard_s, heard_s + 13.0)[:2]
        waited_s.append(look_s - asked_s)
        heard_s = look_s + 0.5
    assert waited_s == [1.5, 3.0, 6.0, 12.0, 12.0]
    silence.handle_timer(heard_s, heard_s)
    (_, asked_s), (_, look_s) = steps(silence, heard_s + FORGET_S, heard_s + FORGET_S + 3.0)[:2]
    assert look_s - asked_s == 1.5


def test_addresses_are_tried_in_order_from_the_one_that_was_lost() -> None:
    addresses = Addresses(("a", "b", "c"))
    assert [addresses.take() for _ in range(4)] == ["a", "b", "c", "a"]
    addresses.begin_with("b")
    assert [addresses.take() for _ in range(4)] == ["b", "a", "c", "a"]
    assert [addresses.beside(index) for index in range(4)] == ["a", "b", "c", "a"]


def test_where_a_relay_sends_us_is_tried_first_and_forgotten() -> None:
    addresses = Addresses(("a",))
    addresses.begin_with("elsewhere")
    assert [addresses.take() for _ in range(3)] == ["elsewhere", "a", "a"]


def test_several_addresses_are_one_text_with_commas() -> None:
    assert LinkConfig(url="ws://a, ws://b:1,ws://a").urls == ("ws://a", "ws://b:1")
    with pytest.raises(OptionError, match="url 'b:1' is no relay address"):
        LinkConfig(url="ws://a,b:1")


def test_a_first_join_is_refused_at_once() -> None:
    with pytest.raises(RelayRefusedError, match="full"):
        Refusals().receive(FULL, 0.0, is_last=True)


def test_who_was_in_the_room_tries_for_a_minute_and_says_so() -> None:
    refusals = Refusals()
    refusals.note_joined()
    for now in (100.0, 100.0 + RETURN_S - 1):
        refusals.receive(FULL, now, is_last=True)
    with pytest.raises(RelayRefusedError, match="full; tried to come back for 60 s"):
        refusals.receive(FULL, 100.0 + RETURN_S, is_last=True)


def test_a_join_begins_the_minute_anew() -> None:
    refusals = Refusals()
    refusals.note_joined()
    refusals.receive(OptionError("no token"), 0.0, is_last=True)
    refusals.note_joined()
    refusals.receive(FULL, 2 * RETURN_S, is_last=True)


def test_a_relay_that_is_away_is_no_refusal_and_another_address_is_tried_first() -> None:
    refusals = Refusals()
    refusals.receive(RelayUnreachableError("away"), 0.0, is_last=True)
    refusals.receive(FULL, 0.0, is_last=False)


@pytest.mark.parametrize("code", [CloseCode.FORBIDDEN, CloseCode.REMOVED, CloseCode.REPLACED])
def test_what_nobody_mends_by_waiting_is_final_for_everybody(code: CloseCode) -> None:
    refusals = Refusals()
    refusals.note_joined()
    refused = refusal_of("ws://a", Closed(code=code, reason="no", is_remote=True))
    assert refused is not None
    with pytest.raises(RelayRefusedError, match=rf"ws://a: the relay said no: no \(code {code}\)"):
        refusals.receive(refused, 0.0, is_last=False)
