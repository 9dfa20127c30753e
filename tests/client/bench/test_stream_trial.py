"""Streams through troubles on the virtual clock: what a receiver gets, and what it shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.toy import make_toy_avatar
from pica_client.bench.impairment import BY_NAME, CALM, Scenario
from pica_client.bench.stream_trial import Delivery, deliver, play
from pica_client.playout.buffer import Playout
from pica_core.codec.latent_stream import LatentDecoder, LatentEncoder, LatentSample

pytestmark = pytest.mark.unit

SECONDS = 9.0
PROFILE = make_toy_avatar().stream_profile()


def face(time_s: float) -> LatentSample:
    return LatentSample(
        latent=np.full((8, 8, 4), np.sin(time_s), np.float32),
        rotation=np.zeros(3, np.float32),
        translation_m=np.zeros(3, np.float32),
    )


def deliver_face(scenario: str | Scenario) -> Delivery:
    chosen = BY_NAME[scenario] if isinstance(scenario, str) else scenario
    return deliver(face, LatentEncoder(PROFILE), chosen, SECONDS)


def test_the_trouble_begins_and_ends_with_the_middle_third() -> None:
    scenario = replace(BY_NAME["jitter-0"], trouble=replace(CALM, delay_s=0.3))
    delivery = deliver_face(scenario)
    transit = {
        frame.sequence: arrived_s - frame.sequence / 30 for arrived_s, frame in delivery.faces
    }
    assert transit[89] == pytest.approx(0.02)
    assert transit[90] == pytest.approx(0.3)
    assert transit[179] == pytest.approx(0.3)
    assert transit[200] == pytest.approx(0.02)


def test_on_a_calm_network_every_frame_is_shown_in_time() -> None:
    delivery = deliver_face("jitter-0")
    assert len(delivery.faces) == 270
    ticks = play(delivery, LatentDecoder(PROFILE), Playout())
    assert len(ticks) == 540
    shown = [tick for tick in ticks if tick.now_s > 1]
    assert all(tick.played is not None and not tick.played.is_concealed for tick in shown)
    assert max(tick.report.delay_s for tick in shown) < 2 / 30
