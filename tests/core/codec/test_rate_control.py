"""Keeping a bitrate: the bucket with literal times, and whole streams of a shipped avatar."""

from __future__ import annotations

import functools
from importlib import resources
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.stream_toy import Publisher
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.avatar.file import load_avatar
from pica_core.capture.stage.expressions import range_of_motion, sentence
from pica_core.codec.latent_stream import StreamConfig
from pica_core.codec.profile import StreamProfile
from pica_core.codec.rate_control import RateController

pytestmark = pytest.mark.unit

FPS = 30
SECONDS = 14
RESTS_AT_S = 10
"""The range of motion ends there: a face at rest has less to say than any target."""


def test_a_frame_may_take_a_share_of_what_is_in_the_bucket() -> None:
    controller = RateController(2000, 8, 3)  # holds 1000 bits
    assert controller.has_room(62, 0, 0.0)
    assert not controller.has_room(63, 0, 0.0)
    assert controller.has_room(43, 1, 0.0)
    assert not controller.has_room(44, 1, 0.0)
    assert controller.has_room(31, 2, 0.0)
    assert not controller.has_room(32, 2, 0.0)


def test_what_is_sent_is_gone_until_time_fills_the_bucket() -> None:
    controller = RateController(2000, 8, 3)
    controller.sent(100, 3, 0.0)  # 800 of 1000 bits
    assert not controller.has_room(13, 0, 0.0)
    assert controller.has_room(12, 0, 0.0)
    assert controller.has_room(25, 0, 0.1)
    assert controller.has_room(62, 0, 9.0)  # full, and no fuller
    assert not controller.has_room(63, 0, 9.0)


def test_debt_is_bounded_so_that_the_stream_comes_back() -> None:
    controller = RateController(1000, 8, 3)
    controller.sent(10_000, 0, 0.0)
    assert not controller.has_room(1, 0, 0.49)
    assert controller.has_room(1, 0, 0.52)


def test_quality_rises_by_one_with_a_base_frame_and_never_with_an_upper_one() -> None:
    controller = RateController(2000, 8, 3)
    assert [controller.propose(layer) for layer in (0, 1, 2)] == [4, 3, 3]
    controller.sent(10, 7, 0.0)
    assert controller.quality == controller.propose(0) == 7
    controller.sent(10, 0, 0.1)
    assert [controller.propose(layer) for layer in (0, 1, 2)] == [1, 0, 0]


def test_a_clock_that_stands_or_runs_backwards_fills_nothing() -> None:
    controller = RateController(2000, 8, 3)
    controller.sent(125, 3, 10.0)
    assert not controller.has_room(1, 0, 10.0)
    assert not controller.has_room(1, 0, 5.0)


@settings(max_examples=50)
@given(data=st.data())
def test_frames_with_room_never_make_more_than_the_rate_and_what_the_bucket_holds(
    data: st.DataObject,
) -> None:
    controller = RateController(3000, 8, 3)
    now_s, sent = 0.0, []
    for _ in range(data.draw(st.integers(1, 80))):
        now_s += data.draw(st.sampled_from([0.0, 0.004, 0.033, 0.5]))
        num_bytes, layer = data.draw(st.integers(0, 120)), data.draw(st.integers(0, 2))
        if controller.has_room(num_bytes, layer, now_s):
            controller.sent(num_bytes, 3, now_s)
            sent.append((now_s, 8 * num_bytes))
    for begin_s, _ in sent:
        window = [bits for at_s, bits in sent if begin_s <= at_s < begin_s + 1]
        assert sum(window) <= 1.5 * 3000


@functools.cache
def shipped() -> tuple[StreamProfile, dict[str, npt.NDArray[np.float32]]]:
    """The tables of the avatar that benches keep, and latents of talk and of large motions."""
    path = Path(str(resources.files("pica_core"))) / "avatars" / "nora.pica"
    avatar = load_avatar(path)
    profile, encoder = avatar.stream_profile(), ExpressionEncoder(avatar)
    assert profile is not None
    return profile, {
        name: np.stack([encoder.encode(values) for values in make(rng, FPS * SECONDS)])
        for name, make, rng in (
            ("talk", sentence, np.random.default_rng(5)),
            ("motion", range_of_motion, np.random.default_rng(6)),
        )
    }


def show(faces: npt.NDArray[np.float32], config: StreamConfig) -> npt.NDArray[np.int64]:
    """Quality, bits and layer of each face's frame; -1, 0 and -1 where there was none."""
    publisher = Publisher(config, profile=shipped()[0])
    rows = []
    for index, face in enumerate(faces):
        nod = 0.05 * np.sin(index / 20) * np.ones((2, 3))
        frame = publisher.show(face, nod * [[1], [0.1]], round(index * 1e6 / FPS))
        rows.append(
            (-1, 0, -1)
            if frame is None
            else (frame.state.quality, 8 * len(frame.payload), frame.layer)
        )
    return np.array(rows).T


@pytest.mark.parametrize("name", ["talk", "motion"])
@pytest.mark.parametrize("target_bps", [1000, 2000, 4000, 8000])
def test_every_second_keeps_to_the_target(name: str, target_bps: int) -> None:
    _, bits, layer = show(shipped()[1][name], StreamConfig(target_bps=target_bps))
    seconds = np.convolve(bits, np.ones(FPS), "valid")[2 * FPS :]
    assert seconds.max() <= 1.5 * target_bps
    busy = slice(2 * FPS, RESTS_AT_S * FPS)
    if target_bps <= 2000:  # beyond, the finest quality has no more to say
        assert bits[busy].sum() / (RESTS_AT_S - 2) == pytest.approx(target_bps, rel=0.1)
        assert seconds[: (RESTS_AT_S - 3) * FPS].min() >= 0.5 * target_bps
    # Base frames come whatever happens; of the others some do not, most of a face that moves all
    # it can through twice the bits that there are for it.
    assert (layer == 0).sum() == len(layer) // 4
    most_left_out = {("talk", 1000): 0.2, ("motion", 1000): 0.3, ("motion", 2000): 0.03}
    assert (layer < 0).mean() <= most_left_out.get((name, target_bps), 0.01)


@pytest.mark.parametrize("name", ["talk", "motion"])
@pytest.mark.parametrize("target_bps", [1000, 2000, 4000])
def test_quality_does_not_swing(name: str, target_bps: int) -> None:
    quality, _, layer = show(shipped()[1][name], StreamConfig(target_bps=target_bps))
    base = quality[layer == 0]
    assert np.diff(base).max() <= 2  # one up at the frame itself, and none between
    by_second = quality[2 * FPS : RESTS_AT_S * FPS].reshape(-1, FPS).mean(axis=1)
    assert np.abs(np.diff(by_second)).max() <= 2


def rest_bits(config: StreamConfig, seconds: int) -> npt.NDArray[np.int64]:
    """Bits of each face of a talk that rests for so long after three seconds, then goes on."""
    publisher = Publisher(config, profile=shipped()[0])
    face = shipped()[1]["talk"]
    performance = [*face[:90], *[face[89]] * (seconds * FPS), *face[90:]]
    frames = [
        publisher.show(latent, np.zeros((2, 3)), round(index * 1e6 / FPS))
        for index, latent in enumerate(performance)
    ]
    return np.array([0 if frame is None else 8 * len(frame.payload) for frame in frames])


def test_waking_after_a_silence_keeps_to_the_target_too() -> None:
    bits = rest_bits(StreamConfig(target_bps=2000), 10)
    assert np.convolve(bits, np.ones(FPS), "valid")[2 * FPS :].max() <= 1.5 * 2000


def test_a_still_face_costs_little_more_than_its_keyframe_every_ten_seconds() -> None:
    bits = rest_bits(StreamConfig(), 60)
    silent = bits[5 * FPS : 63 * FPS]
    is_key = silent > 100
    assert is_key.sum() in (5, 6)
    assert silent[~is_key].sum() / 58 < 30  # heartbeats
    assert silent.sum() / 58 < 80
