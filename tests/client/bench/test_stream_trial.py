"""Streams through troubles on the virtual clock: what a receiver gets, and what it shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.toy import make_toy_avatar
from pica_client.bench.impairment import BY_NAME, CALM
from pica_client.bench.stream_trial import deliver
from pica_core.codec.latent_stream import LatentEncoder, LatentSample

pytestmark = pytest.mark.unit

PROFILE = make_toy_avatar().stream_profile()


def face(time_s: float) -> LatentSample:
    return LatentSample(
        latent=np.full((8, 8, 4), np.sin(time_s), np.float32),
        rotation=np.zeros(3, np.float32),
        translation_m=np.zeros(3, np.float32),
    )


def test_the_trouble_begins_and_ends_with_the_middle_third() -> None:
    scenario = replace(BY_NAME["jitter-0"], trouble=replace(CALM, delay_s=0.3))
    delivery = deliver(face, LatentEncoder(PROFILE), scenario, 9.0)
    transit = {
        frame.sequence: arrived_s - frame.sequence / 30 for arrived_s, frame in delivery.faces
    }
    assert transit[89] == pytest.approx(0.02)
    assert transit[90] == pytest.approx(0.3)
    assert transit[179] == pytest.approx(0.3)
    assert transit[200] == pytest.approx(0.02)
