"""Streams through troubles on the virtual clock: what a receiver gets, and what it shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from pica_client.bench.network.scenarios import BY_NAME, CALM, POLICIES, SCENARIOS, Scenario
from pica_client.bench.network.stream_trial import Delivery, Schedule, deliver, play
from pica_client.errors import OptionError
from pica_client.playout.buffer import Playout
from pica_core.codec.latent_sample import DecodedFrame, EncodedFrame, LatentSample, ReceivedFrame
from pica_core.codec.plain_stream import PlainDecoder, PlainEncoder

pytestmark = pytest.mark.unit

SHORT = Schedule(seconds=9.0)
PLAIN = (4.0,) * 4


def face(time_s: float) -> LatentSample:
    return LatentSample(
        latent=np.full((8, 8, 4), np.sin(time_s), np.float32),
        rotation=np.zeros(3, np.float32),
        translation_m=np.zeros(3, np.float32),
    )


def deliver_plain(scenario: str | Scenario, *, seed: int = 0) -> Delivery:
    chosen = BY_NAME[scenario] if isinstance(scenario, str) else scenario
    return deliver(face, (PlainEncoder(PLAIN), PlainDecoder(PLAIN)), chosen, SHORT, seed=seed)


class ChainEncoder:
    """Every frame refers to the one before it, as in a stream of one layer."""

    def __init__(self) -> None:
        self._wanted = True
        self.granted = 0

    def request_keyframe(self) -> None:
        self._wanted = True

    restart = request_keyframe

    def encode(
        self,
        latent: npt.ArrayLike,
        rotation: npt.ArrayLike,
        translation_m: npt.ArrayLike,
        now_us: int,
    ) -> EncodedFrame:
        is_keyframe, self._wanted = self._wanted, False
        self.granted += is_keyframe
        return EncodedFrame(b"x", 0, is_keyframe)


class ChainDecoder:
    def __init__(self) -> None:
        self._next: int | None = None
        self.needs_keyframe = False
        self.num_unreferenced = 0

    def receive(self, frame: ReceivedFrame) -> list[DecodedFrame]:
        if not frame.is_keyframe and frame.number != self._next:
            self.needs_keyframe = True
            return []
        self._next, self.needs_keyframe = frame.number + 1, False
        return [frame.decoded(face(0))]


def test_the_trouble_begins_and_ends_with_the_middle_third() -> None:
    scenario = replace(BY_NAME["jitter-0"], trouble=replace(CALM, delay_s=0.3))
    delivery = deliver_plain(scenario)
    transit = {
        arrival.number: arrival.arrived_s - arrival.number / 30 for arrival in delivery.arrivals
    }
    assert transit[89] == pytest.approx(0.02)
    assert transit[90] == pytest.approx(0.3)
    assert transit[179] == pytest.approx(0.3)
    assert transit[200] == pytest.approx(0.02)


def test_every_scenario_is_the_same_for_the_same_seed() -> None:
    for scenario in SCENARIOS:
        first, second = deliver_plain(scenario, seed=5), deliver_plain(scenario, seed=5)
        assert [a.arrived_s for a in first.arrivals] == [a.arrived_s for a in second.arrivals]
        assert first.counters == second.counters


def test_on_a_calm_network_every_frame_is_shown_in_time() -> None:
    delivery = deliver_plain("jitter-0")
    assert len(delivery.arrivals) == 270
    for config in POLICIES.values():
        ticks = play(delivery, Playout(config), SHORT)
        assert len(ticks) == 540
        shown = [tick for tick in ticks if tick.now_s > 1]
        assert all(tick.played is not None for tick in shown)
        assert not any(tick.played.is_concealed for tick in shown if tick.played)
        ages = [tick.now_s - tick.shown_s for tick in shown]
        assert max(ages) < 0.02 + config.ceiling_s + 1 / 30 + 1e-3


def test_a_missing_reference_is_healed_by_a_keyframe_after_one_round_trip() -> None:
    scenario = replace(
        BY_NAME["loss-10"], trouble=replace(BY_NAME["loss-10"].trouble, jitter_s=0.0)
    )
    encoder = ChainEncoder()
    delivery = deliver(face, (encoder, ChainDecoder()), scenario, SHORT, seed=1)
    assert delivery.keyframe_requests > 0
    assert delivery.keyframes == encoder.granted == delivery.keyframe_requests + 1
    gaps = np.diff([arrival.arrived_s for arrival in delivery.arrivals])
    assert delivery.arrivals[-1].arrived_s > 8.9
    # Lost frame, next frame, 40 ms there and back, up to a frame interval for the next capture; a
    # request may wait half a second for the one before it, and a keyframe may be lost itself.
    assert np.median(gaps[gaps > 0.05]) < 0.6


def test_nothing_shown_before_the_first_frame_is_no_face() -> None:
    ticks = play(deliver_plain("jitter-0"), Playout(), SHORT)
    assert ticks[0].played is None
    with pytest.raises(ValueError, match="nothing is shown"):
        _ = ticks[0].shown_s


def test_a_schedule_out_of_range_is_refused() -> None:
    for arguments in ({"seconds": 1}, {"fps": 0}, {"display_hz": float("nan")}):
        with pytest.raises(OptionError):
            Schedule(**arguments)
