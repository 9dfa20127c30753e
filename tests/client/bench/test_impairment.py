"""The model of the network: what it does to frames, against what it says it does."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pica_client.bench.impairment import BY_NAME, CALM, MAX_GAP_S, SCENARIOS, Impairment, Way
from pica_client.bench.stream_trial import FramePath, deliver
from pica_client.errors import OptionError
from pica_core.avatar.arkit import NUM_ARKIT, ExpressionFrame
from pica_core.codec.latent_stream import LatentEncoder
from pica_protocol.frames import Frame

pytestmark = pytest.mark.unit

FRAME_S = 1 / 30


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def run(
    impairment: Impairment, count: int, *, seed: int = 0
) -> tuple[list[tuple[float, int]], FramePath]:
    """Send frames 0.. of 100 bytes at 30 fps, and take all that comes within another 20 s."""
    path = FramePath(impairment, rng(seed))
    arrived = []
    for index in range(count):
        now = index * FRAME_S
        arrived += path.arrivals(now)
        path.send(Frame(stream=1, sequence=index, captured_us=0, payload=bytes(49)), now)
    arrived += path.arrivals(count * FRAME_S + 20)
    return [(arrival_s, frame.sequence) for arrival_s, frame in arrived], path


def delays(arrived: list[tuple[float, int]]) -> np.ndarray:
    return np.array([arrival_s - index * FRAME_S for arrival_s, index in arrived])


def test_jitter_has_the_stated_percentile_and_a_heavy_tail() -> None:
    impairment = Impairment(jitter_s=0.05)
    extra = []
    for seed in range(2000):  # alone on its way, a piece waits for no other
        extra.append(Way(impairment, rng(seed)).transmit(100, 0.0) - impairment.delay_s)
    assert np.quantile(extra, 0.95) == pytest.approx(0.05, rel=0.15)
    assert np.quantile(extra, 0.99) == pytest.approx(0.106, rel=0.25)
    assert min(extra) >= 0
    assert max(extra) <= 5 * 0.05 + 1e-9


@given(st.sampled_from(SCENARIOS), st.integers(0, 1000))
def test_nothing_is_overtaken_comes_twice_or_is_lost_without_a_count(scenario, seed) -> None:  # type: ignore[no-untyped-def]
    arrived, path = run(scenario.trouble, 120, seed=seed)
    times, indices = zip(*arrived, strict=True)
    assert list(times) == sorted(times)
    assert list(indices) == sorted(set(indices))
    assert len(arrived) + path.drops.total() == 120


def test_after_a_gap_everything_comes_at_once() -> None:
    arrived, _ = run(Impairment(gap_s=0.5, gap_interval_s=3), 200)
    times = np.array([arrival_s for arrival_s, _ in arrived])
    gaps = np.diff(times)
    assert len(arrived) == 200
    assert gaps.max() == pytest.approx(0.5, abs=FRAME_S)
    held = np.flatnonzero(np.isclose(times, times[gaps.argmax() + 1]))
    assert len(held) == pytest.approx(15, abs=1)


def test_loss_on_a_stream_is_a_delay_for_all_behind_it() -> None:
    arrived, _ = run(Impairment(loss_ratio=0.05), 300)
    extra = delays(arrived) - CALM.delay_s
    assert len(arrived) == 300
    late = extra > 0.19
    stalls = np.flatnonzero(np.diff(late.astype(int)) == 1).size
    assert 5 <= stalls <= 25
    # Six frames are captured while one waits for its retransmission; they wait with it.
    assert (extra > 0.001).sum() >= 5 * stalls


def test_a_rate_below_the_demand_keeps_the_delay_bounded() -> None:
    # 30 messages of 100 bytes are 24 kbit/s: 12 kbit/s carry half of them.
    impairment = Impairment(rate_bps=12_000, queue_bytes=400)
    arrived, path = run(impairment, 600)
    assert path.drops.total() == 600 - len(arrived) > 100
    # The queue, one message more, what is leaving, and the newest frame.
    assert delays(arrived).max() < CALM.delay_s + 8 * (400 + 3 * 100) / 12_000


@pytest.mark.parametrize(("name", "longest_s"), [("walk", 0.5), ("car", 1.0), ("train", 3.0)])
def test_a_cellular_way_has_hundreds_of_gaps_and_some_long_stalls(
    name: str, longest_s: float
) -> None:
    way = Way(BY_NAME[f"cellular-{name}"].trouble, rng())
    arrived_s = np.array([way.transmit(100, index * FRAME_S) for index in range(300 * 30)])
    gaps = np.diff(arrived_s)
    assert min(gaps) >= 0
    assert 200 < (gaps > 0.1).sum() < 400
    assert longest_s < max(gaps) <= MAX_GAP_S + 0.1
    # What waited comes at once, and at the end nothing waits any more.
    assert (gaps < 0.001).sum() > 500
    assert np.median(arrived_s - np.arange(len(arrived_s)) * FRAME_S) < 0.05


def test_an_impairment_out_of_range_is_refused() -> None:
    for arguments in ({"jitter_s": float("nan")}, {"loss_ratio": 1.0}):
        with pytest.raises(OptionError):
            Impairment(**arguments)


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
