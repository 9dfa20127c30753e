"""A relay on a real port among strangers; ``scripts/fuzz_live.py`` lets more of them loose."""

import os

import pytest

from fuzzing.live import besiege, documented_codes
from pica_protocol.errors import CloseCode

pytestmark = pytest.mark.realtime

if os.name == "nt":
    pytest.skip("stops the relay with Unix signals", allow_module_level=True)


def test_a_live_relay_outlives_strangers_and_a_room_beside_them_loses_nothing() -> None:
    figures = besiege(1500, seed=1500)
    assert figures["healthy_lost"] == 0
    assert figures["healthy_frames"] > 0
    assert {str(int(CloseCode.MALFORMED)), str(int(CloseCode.PROTOCOL_ERROR))} <= set(
        figures["close_codes"]
    )
    assert {"101", "404"} <= set(figures["http_statuses"])
    assert figures["health_checks"] > 0


def test_the_strangers_know_the_codes_of_the_document() -> None:
    assert documented_codes() == frozenset(map(int, CloseCode))
