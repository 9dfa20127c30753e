"""Streams through troubles on the virtual clock: what a receiver gets, and what it shows."""

from dataclasses import replace

import numpy as np
import pytest

from pica_client.bench.impairment import BY_NAME, CALM
from pica_client.bench.stream_trial import deliver
from pica_core.avatar.arkit import NUM_ARKIT, ExpressionFrame
from pica_core.codec.latent_stream import LatentEncoder

pytestmark = pytest.mark.unit


def face(time_s: float) -> ExpressionFrame:
    return ExpressionFrame(
        captured_us=round(time_s * 1e6), arkit=np.full(NUM_ARKIT, time_s / 9, np.float32)
    )


def test_the_trouble_begins_and_ends_with_the_middle_third() -> None:
    scenario = replace(BY_NAME["jitter-0"], trouble=replace(CALM, delay_s=0.3))
    delivery = deliver(face, LatentEncoder(), scenario, 9.0)
    transit = {
        frame.sequence: arrived_s - frame.sequence / 30 for arrived_s, frame in delivery.faces
    }
    assert transit[89] == pytest.approx(0.02)
    assert transit[90] == pytest.approx(0.3)
    assert transit[179] == pytest.approx(0.3)
    assert transit[200] == pytest.approx(0.02)
