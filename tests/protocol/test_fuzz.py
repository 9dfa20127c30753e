"""Damaged messages by the thousand; ``make fuzz`` throws more of them."""

import pytest

from fuzzing import campaign
from fuzzing.campaign import FuzzFailure, run
from pica_protocol.errors import CloseCode

pytestmark = [pytest.mark.unit, pytest.mark.slow]


def test_twenty_thousand_damaged_messages_are_accepted_or_refused_as_documented() -> None:
    figures = run(20_000, seed=20_000)
    outcomes = figures["outcomes"]
    assert outcomes["accepted"] > 5000
    assert outcomes["refused MALFORMED"] > 2000
    assert set(figures["by_target"]) == set(campaign.TARGETS)


def test_what_nothing_documents_ends_the_run_with_the_line_that_repeats_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def broken(data: bytes, limit: int) -> object:
        raise KeyError(data[:1])

    monkeypatch.setattr("fuzzing.targets.decode_message", broken)
    with pytest.raises(FuzzFailure, match=r"codec: KeyError.*\n.*--seed 3 --round 0 "):
        run(1, seed=3)


def test_a_peer_that_is_closed_with_a_code_of_nobodys_ends_the_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    documented = frozenset(map(int, CloseCode)) - {int(CloseCode.MALFORMED)}
    monkeypatch.setattr("fuzzing.targets.OUR_CODES", documented)
    with pytest.raises(FuzzFailure, match="a code that nobody documents"):
        run(1, seed=3)


def test_a_message_that_takes_much_memory_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign, "MOST_BYTES_A_CALL", 10)
    with pytest.raises(FuzzFailure, match="one call of codec held"):
        run(1, seed=3)


def test_a_round_is_the_same_whatever_came_before_it() -> None:
    whole = run(3000, seed=5, is_tracing=False)
    begin = run(1000, seed=5, is_tracing=False)
    rest = run(3000 - begin["damaged"], seed=5, first_round=begin["rounds"], is_tracing=False)
    assert begin["rounds"] + rest["rounds"] == whole["rounds"]
    assert begin["damaged"] + rest["damaged"] == whole["damaged"]
