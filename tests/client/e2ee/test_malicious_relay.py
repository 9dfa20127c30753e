"""Dozens of calls on a relay that does what it should not; more with ``MALICE_RUNS=10000``."""

import os
from collections import Counter

import pytest

pytest.importorskip("cryptography", reason="needs the extra seal")

from malice.relay import TRICKS, run

pytestmark = [pytest.mark.call, pytest.mark.slow]

RUNS = int(os.environ.get("MALICE_RUNS", "60"))


def test_a_malicious_relay_shows_nothing_twice_nor_as_somebody_elses_nor_after_a_leave() -> None:
    counts = sum((run(seed) for seed in range(RUNS)), Counter[str]())
    assert all(counts[trick.__name__] > RUNS / 4 for trick in TRICKS)
    assert counts["shown"] > 50 * RUNS
    assert counts["tried by leavers"] > RUNS
