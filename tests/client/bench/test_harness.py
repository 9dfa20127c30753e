"""Turns and times of the benches."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from pica_client.bench.harness import median_ms, spread, take_turns
from pica_client.errors import OptionError, check_ranges

pytestmark = pytest.mark.unit


def test_everybody_works_once_a_round_in_an_order_that_changes() -> None:
    order: list[str] = []

    def work(case: str, number: int) -> tuple[str, int]:
        order.append(case)
        return case, number

    found = take_turns("abc", work, rounds=20, warm_up=3, seed=0)
    rounds = ["".join(order[i : i + 3]) for i in range(0, len(order), 3)]
    assert len(rounds) == 23
    assert all(sorted(each) == ["a", "b", "c"] for each in rounds)
    assert len(set(rounds)) > 3
    assert found == [[(case, number) for number in range(20)] for case in "abc"]


def test_without_a_seed_the_order_stays() -> None:
    order: list[str] = []
    take_turns("abc", lambda case, _: order.append(case), rounds=2, warm_up=1)
    assert order == list("abcabcabc")


def test_times_are_told_in_milliseconds_and_their_spread_as_a_share() -> None:
    assert median_ms([0.003, 0.001, 0.002]) == 2
    assert spread([1.0, 2.0, 3.0]) == 1
    assert spread([1.0]) == 0


def test_a_setting_out_of_range_is_named_with_the_range() -> None:
    @dataclass
    class Config:
        rounds: int = 0

    with pytest.raises(OptionError, match="rounds is 0; 1 to 10 is allowed"):
        check_ranges(Config(), rounds=(1, 10))
