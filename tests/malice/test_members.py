"""Calls with members who mean harm; more with ``MALICE_RUNS=10000``."""

import os
from collections import Counter

import pytest

from malice.members import TRICKS, run

pytestmark = [pytest.mark.call, pytest.mark.slow]

RUNS = int(os.environ.get("MALICE_RUNS", "25"))


def test_no_member_starves_mutes_relabels_or_outlives_another() -> None:
    counts = sum((run(seed) for seed in range(RUNS)), Counter[str]())
    assert {trick.__name__ for trick in TRICKS} <= set(counts)
