"""Damaged messages by the thousand; ``make fuzz`` throws more of them."""

import pytest

from fuzzing import campaign
from fuzzing.campaign import FuzzFailure, run

pytestmark = [pytest.mark.unit, pytest.mark.slow]


def test_thousands_of_damaged_messages_are_accepted_or_refused_as_documented() -> None:
    figures = run(6_000, seed=6_000)
    outcomes = figures["outcomes"]
    assert outcomes["accepted"] > 1500
    assert outcomes["refused MALFORMED"] > 600
    assert set(figures["by_target"]) == set(campaign.TARGETS)


def test_what_nothing_documents_ends_the_run_with_the_line_that_repeats_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def broken(data: bytes, limit: int) -> object:
        raise KeyError(data[:1])

    monkeypatch.setattr("fuzzing.targets.decode_message", broken)
    with pytest.raises(FuzzFailure, match=r"codec: KeyError.*\n.*--seed 3 --round 0 "):
        run(1, seed=3)
