"""Rows of an evaluation as tables."""

from __future__ import annotations

import pytest

from pica_core.train.eval.tables import paired_table

pytestmark = pytest.mark.unit


def test_models_are_compared_with_the_full_one_frame_by_frame() -> None:
    errors = {
        "full": (10.0, 50.0, 30.0),
        "baseline": (12.0, 52.5, 31.5),
        "coarse": (9.0, 49.0, 29.0),
    }
    distributions = {
        ("S1", variant, "", 0): [
            {"frame": str(number), "mse": value} for number, value in enumerate(values)
        ]
        for variant, values in errors.items()
    }
    distributions["S2", "baseline", "", 0] = [{"frame": "0", "mse": 1.0}]  # nobody to compare with

    table = paired_table(distributions, ("baseline", "full", "coarse")).splitlines()

    assert len(table) == 4
    assert table[2].startswith("| S1 | baseline | +2.00 (+1.50 to +2.50) | 3 of 3 |")
    assert table[3].startswith("| S1 | coarse | -1.00 (-1.00 to -1.00) | 0 of 3 |")
