"""Rows of an evaluation as tables."""

from __future__ import annotations

import pytest

from pica_core.train.cli.eval import distribution_table, error_table
from pica_core.train.evaluate import bootstrap_interval

pytestmark = pytest.mark.unit

ROW = {"identity": "S1", "view": "front", "mse_low": 0.0, "mse_high": 9.0, "variant": "full"}


def test_seeds_are_shown_as_their_mean_with_the_lowest_and_the_highest() -> None:
    rows = [{**ROW, "seed": seed, "mse": mse} for seed, mse in enumerate((3.0, 2.0, 4.0))]
    rows.append({**ROW, "variant": "baseline", "seed": 0, "mse": 2.5})

    lines = error_table(rows, ("full", "baseline")).splitlines()

    assert lines[2:] == [
        "| S1 | full | 3.00 (2.00 to 4.00) |",
        "| S1 | baseline | **2.50** (0.00 to 9.00) |",
    ]


def test_an_interval_over_seeds_is_wider_than_that_of_their_mean() -> None:
    seeds = [[9.0, 10.0, 11.0], [19.0, 20.0, 21.0]]

    low, high = bootstrap_interval(seeds)

    assert bootstrap_interval([14.0, 15.0, 16.0]) == pytest.approx((14.0, 16.0), abs=0.35)
    assert low < 11 < 19 < high


def test_the_spread_over_expressions_is_of_the_mean_over_seeds() -> None:
    rows = [
        {**ROW, "seed": seed, "by_frame": {"a": 10.0 + seed + side, "b": 20.0 + seed + side}}
        for seed in range(3)
        for side in (-1, 1)
    ]

    (line,) = distribution_table(rows, ("full",)).splitlines()[2:]

    assert line.startswith("| S1 | full | 16.00 (")
    assert line.endswith("| 21.00 | 20.00 | 18.50 | 16.00 | 13.50 | 12.00 | 11.00 |")
