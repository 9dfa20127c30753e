"""Turns and times of the benches."""

import pytest

from pica_client.bench.harness import ratio, take_turns, times_ms

pytestmark = pytest.mark.unit


def test_cases_work_once_a_round_and_every_second_round_backwards() -> None:
    order: list[str] = []

    def work(case: str, number: int) -> tuple[str, int]:
        order.append(case)
        return case, number

    found = take_turns("abc", work, rounds=3, warm_up=1)
    assert "".join(order) == "abc" + "abc" + "cba" + "abc"
    assert found == [[(case, number) for number in range(3)] for case in "abc"]


def test_times_are_told_in_milliseconds_and_their_spread_as_a_share() -> None:
    times = times_ms([0.003, 0.001, 0.002])
    assert times == {"ms": 2, "p95": 3, "spread": 1}
    assert times_ms([1.0])["spread"] == 0


def test_a_ratio_compares_times_of_the_same_round() -> None:
    assert ratio([4.0, 20.0, 3.0], [2.0] * 3) == 2
