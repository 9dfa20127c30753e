"""Whole streams: what a receiver shows is what the sender meant, whatever happens on the way."""

from __future__ import annotations

import dataclasses
import random
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.stream_toy import (
    STILL,
    Publisher,
    Sent,
    assert_shown_is_true,
    deliver,
    deliver_all,
    other_profile,
    perform,
    toy_faces,
    toy_metric,
    toy_pose,
    toy_profile,
)
from pica_core.codec.latent_encoder import LAYER_PATTERNS
from pica_core.codec.latent_sample import DecodedFrame
from pica_core.codec.latent_stream import LatentDecoder, LatentEncoder, StreamConfig
from pica_core.errors import LatentError, ShapeError

pytestmark = pytest.mark.unit

NEUTRAL = np.zeros((8, 8, 4))


@st.composite
def lives(draw: st.DrawFn) -> list[Sent]:
    """A stream in which anything may happen, from any first number on."""
    config = StreamConfig(
        num_layers=draw(st.integers(1, 3)),
        target_bps=draw(st.sampled_from([None, None, 800.0, 4000.0])),
        quality=draw(st.integers(0, 7)),
        keyframe_interval_s=draw(st.sampled_from([0.5, 10.0])),
    )
    first = draw(st.sampled_from([0, 1, 32_767, 65_500, 65_535, 1_000_000]))
    publisher = Publisher(config, first_number=first)
    face, now_us = NEUTRAL, 0
    for _ in range(draw(st.integers(1, 6))):
        match draw(st.sampled_from(["talk", "rest", "leap", "ask", "quality", "restart", "pause"])):
            case "talk":
                seed, length = draw(st.integers(0, 99)), draw(st.integers(1, 40))
                live = draw(st.sampled_from([0.2, 1.0, 4.0]))
                poses = toy_pose(seed, length)
                for face, pose in zip(toy_faces(seed, length, live), poses, strict=True):
                    now_us += 33_333
                    publisher.show(face, pose, now_us)
            case "rest":
                for _ in range(draw(st.integers(1, 90))):
                    now_us += 33_333
                    publisher.show(face, np.zeros((2, 3)), now_us)
            case "leap":
                face = np.random.default_rng(draw(st.integers(0, 99))).normal(
                    0, draw(st.sampled_from([1.0, 30.0, 1e6])), (8, 8, 4)
                )
                now_us += 33_333
                pose = np.full((2, 3), draw(st.sampled_from([0.0, 3.1, -3.1, 1e9])))
                publisher.show(face, pose, now_us)
            case "ask":
                publisher.encoder.request_keyframe()
            case "quality":
                quality = draw(st.integers(0, 7))
                publisher.encoder.config = dataclasses.replace(
                    publisher.encoder.config, quality=quality
                )
            case "restart":
                publisher.encoder.restart()
            case "pause":
                now_us += draw(st.integers(1, 20_000_000))
    publisher.show(face, np.zeros((2, 3)), now_us + 33_333)
    return publisher.sent


@settings(max_examples=80)
@given(sent=lives())
def test_the_receiver_shows_exactly_what_the_encoder_goes_on_with(sent: list[Sent]) -> None:
    decoder = LatentDecoder(toy_profile())
    shown = list(deliver_all(decoder, sent))
    assert [face.number for face in shown] == [frame.number for frame in sent]
    assert_shown_is_true(shown, sent)
    assert not decoder.needs_keyframe
    assert decoder.num_unreferenced == 0


@settings(max_examples=60)
@given(sent=lives(), data=st.data())
def test_upper_layers_may_go_and_come_back_at_any_moment(
    sent: list[Sent], data: st.DataObject
) -> None:
    # Who thins lets an upper layer in again with a base frame, as the relay does.
    wishes = data.draw(st.lists(st.integers(0, 2), min_size=len(sent), max_size=len(sent)))
    kept, is_open = [], 2
    for frame, wish in zip(sent, wishes, strict=True):
        is_open = wish if frame.layer == 0 else min(is_open, wish)
        if frame.layer <= is_open:
            kept.append(frame)
    decoder = LatentDecoder(toy_profile())
    shown = list(deliver_all(decoder, kept))
    assert [face.number for face in shown] == [frame.number for frame in kept]
    assert_shown_is_true(shown, sent)
    assert (decoder.needs_keyframe, decoder.num_unreferenced) == (False, 0)


@settings(max_examples=60)
@given(sent=lives(), data=st.data())
def test_upper_layers_that_come_back_anywhere_never_disturb_those_below(
    sent: list[Sent], data: st.DataObject
) -> None:
    # Cruder: each upper frame may be missing by itself, its own references included.
    kept = [frame for frame in sent if frame.layer == 0 or data.draw(st.booleans())]
    decoder = LatentDecoder(toy_profile())
    shown = list(deliver_all(decoder, kept))
    assert_shown_is_true(shown, sent)
    below_top = {frame.number for frame in kept if frame.layer < 2}
    assert below_top <= {face.number for face in shown}
    assert not decoder.needs_keyframe


@settings(max_examples=60)
@given(sent=lives(), seed=st.integers(0, 1000))
def test_frames_that_overtake_each_other_by_up_to_six_are_all_shown(
    sent: list[Sent], seed: int
) -> None:
    rng = random.Random(seed)
    # The first one comes first: before it nothing can be told.
    places = [0, *(index + rng.uniform(0, 6) for index in range(1, len(sent)))]
    order = sorted(range(len(sent)), key=places.__getitem__)
    decoder = LatentDecoder(toy_profile())
    shown = list(deliver_all(decoder, [sent[index] for index in order]))
    assert Counter(face.number for face in shown) == Counter(frame.number for frame in sent)
    assert_shown_is_true(shown, sent)
    assert (decoder.needs_keyframe, decoder.num_unreferenced) == (False, 0)


@settings(max_examples=80)
@given(sent=lives(), seed=st.integers(0, 1000), loss=st.sampled_from([0.02, 0.2, 0.6]))
def test_whatever_is_lost_late_or_doubled_no_face_is_ever_wrong(
    sent: list[Sent], seed: int, loss: float
) -> None:
    rng = random.Random(seed)
    arrivals = []
    for index, frame in enumerate(sent):
        for _ in range(rng.choice([1, 1, 1, 2])):
            if rng.random() >= loss:
                arrivals.append((index + rng.expovariate(0.3), index, frame))
    decoder = LatentDecoder(toy_profile())
    shown = list(
        deliver_all(decoder, [frame for _, _, frame in sorted(arrivals, key=lambda a: a[:2])])
    )
    assert_shown_is_true(shown, sent)
    assert max(Counter(face.number for face in shown).values(), default=1) == 1


def test_a_lost_base_frame_asks_for_a_keyframe_and_the_keyframe_heals() -> None:
    publisher = Publisher()
    publisher.show_all(toy_faces(1, 30), toy_pose(1, 30))
    decoder = LatentDecoder(toy_profile())
    lost = publisher.sent[12]
    assert lost.layer == 0
    shown = list(deliver_all(decoder, publisher.sent[:12]))
    assert not decoder.needs_keyframe
    after = list(deliver_all(decoder, publisher.sent[13:]))
    assert after == []  # all of it builds on what is lost
    assert decoder.needs_keyframe
    publisher.encoder.request_keyframe()
    healed = list(deliver_all(decoder, publisher.show_all(toy_faces(2, 20), toy_pose(2, 20))))
    assert len(healed) == 20
    assert publisher.sent[30].is_keyframe
    assert not decoder.needs_keyframe
    assert_shown_is_true(shown + healed, publisher.sent)
    assert decoder.num_unreferenced == 17  # all that waited in vain


def test_a_lost_upper_frame_asks_for_nothing() -> None:
    sent = perform(num_frames=40)
    decoder = LatentDecoder(toy_profile())
    kept = [frame for frame in sent if frame.number not in (5, 10)]  # one of layer 2, one of 1
    assert [sent[5].layer, sent[10].layer] == [2, 1]
    shown = list(deliver_all(decoder, kept))
    assert [frame.number for frame in kept if frame.number != 11] == [f.number for f in shown]
    assert not decoder.needs_keyframe


def test_frames_wait_until_a_late_base_frame_heals_them_in_order() -> None:
    sent = perform(num_frames=24)
    decoder = LatentDecoder(toy_profile())
    assert len(list(deliver_all(decoder, sent[:8]))) == 8
    assert list(deliver_all(decoder, sent[9:14])) == []
    assert decoder.needs_keyframe  # the base frame 12 waits, so this is no small overtaking
    assert [face.number for face in deliver(decoder, sent[8])] == [8, 9, 10, 11, 12, 13]
    assert not decoder.needs_keyframe


def test_duplicates_show_nothing_and_change_nothing() -> None:
    sent = perform(num_frames=40)
    decoder = LatentDecoder(toy_profile())
    for index, frame in enumerate(sent):
        assert len(deliver(decoder, frame)) == 1
        for again in sent[max(index - 3, 0) : index + 1]:
            assert deliver(decoder, again) == []


def test_a_decoder_that_comes_late_waits_for_the_keyframe() -> None:
    publisher = Publisher()
    publisher.show_all(toy_faces(1, 20), toy_pose(1, 20))
    decoder = LatentDecoder(toy_profile())
    assert decoder.needs_keyframe
    assert list(deliver_all(decoder, publisher.sent[7:20])) == []
    assert decoder.needs_keyframe
    publisher.encoder.request_keyframe()
    after = publisher.show_all(toy_faces(3, 8), toy_pose(3, 8))
    assert len(list(deliver_all(decoder, after))) == 8


def test_a_damaged_frame_costs_itself_and_what_builds_on_it_only() -> None:
    sent = perform(num_frames=40)
    decoder = LatentDecoder(toy_profile())
    shown = list(deliver_all(decoder, sent[:8]))
    with pytest.raises(LatentError):
        deliver(decoder, dataclasses.replace(sent[8], payload=b"\xff" * 600))
    assert decoder.needs_keyframe
    shown += deliver(decoder, sent[8])  # the very frame, sent again
    assert not decoder.needs_keyframe
    shown += deliver_all(decoder, sent[9:])
    assert len(shown) == 40


def test_a_damaged_frame_among_those_that_waited_takes_no_other_with_it() -> None:
    sent = perform(num_frames=20)
    decoder = LatentDecoder(toy_profile())
    list(deliver_all(decoder, sent[:4]))
    broken = dataclasses.replace(sent[5], payload=sent[5].payload + b"\xff" * 8)
    assert list(deliver_all(decoder, [broken, sent[6], sent[7]])) == []
    assert [face.number for face in deliver(decoder, sent[4])] == [4, 6, 7]
    assert decoder.num_unreferenced == 1


def test_a_decoder_keeps_seventeen_frames_and_eight_that_wait() -> None:
    sent = perform(num_frames=200)
    decoder = LatentDecoder(toy_profile())
    kept = []
    for frame in [*sent[:100], *sent[101:]]:
        deliver(decoder, frame)
        kept.append(decoder.num_kept)
    assert max(kept[:100]) == 17
    assert max(kept) == 17 + 8


def test_what_a_decoder_keeps_is_bounded_whatever_comes() -> None:
    rng = random.Random(3)
    decoder = LatentDecoder(toy_profile())
    sent = perform(num_frames=200)
    for _ in range(3000):
        frame = rng.choice(sent)
        moved = dataclasses.replace(
            frame,
            number=rng.choice([frame.number, rng.randrange(65536), rng.randrange(300)]),
            captured_us=rng.choice([frame.captured_us, rng.randrange(2**40)]),
        )
        deliver(decoder, moved)
        assert decoder.num_kept <= 17 + 8


@pytest.mark.parametrize(
    ("fps", "layers"), [(1, 1), (9.9, 1), (10, 2), (19, 2), (20, 3), (30, 3), (90, 3), (240, 3)]
)
def test_a_stream_has_as_many_layers_as_leave_five_base_frames_a_second(
    fps: float, layers: int
) -> None:
    config = StreamConfig(fps=fps)
    assert config.layers == layers
    publisher = Publisher(config)
    faces = toy_faces(1, 60)
    publisher.show_all(faces, toy_pose(1, 60), fps=fps)
    shown = list(deliver_all(LatentDecoder(toy_profile()), publisher.sent))
    assert_shown_is_true(shown, publisher.sent)
    pattern = LAYER_PATTERNS[layers]
    kept = [frame.layer for frame in publisher.sent[: len(pattern)]]
    assert kept == list(pattern)
    assert {frame.layer for frame in publisher.sent} == set(pattern)


def test_what_lies_beyond_the_range_is_cut() -> None:
    publisher = Publisher()
    publisher.show(np.full((8, 8, 4), 1e9), np.full((2, 3), -1e9), 0)
    (shown,) = deliver_all(LatentDecoder(toy_profile()), publisher.sent)
    assert shown.sample.rotation == pytest.approx([-np.pi] * 3, abs=2e-3)
    assert np.abs(shown.sample.latent).max() <= 256


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_is_not_sent(value: float) -> None:
    encoder = LatentEncoder(toy_profile())
    with pytest.raises(LatentError, match="not finite"):
        encoder.encode(np.full((8, 8, 4), value), STILL, STILL, 0)
    with pytest.raises(LatentError, match="not finite"):
        encoder.encode(NEUTRAL, [0, value, 0], STILL, 0)
    assert encoder.encode(NEUTRAL, STILL, STILL, 0) is not None


def test_an_array_of_another_shape_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"latent is \(4, 8, 8\)"):
        LatentEncoder(toy_profile()).encode(np.zeros((4, 8, 8)), STILL, STILL, 0)


def test_a_quality_that_the_avatar_does_not_have_is_refused() -> None:
    with pytest.raises(LatentError, match="quality is 8; this avatar has 0 to 7"):
        LatentEncoder(toy_profile(), StreamConfig(quality=8))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("fps", 0),
        ("fps", 2000),
        ("quality", -1),
        ("quality", 16),
        ("target_bps", 10),
        ("num_layers", 4),
        ("keyframe_interval_s", 0),
    ],
)
def test_an_option_out_of_its_range_is_refused_by_name(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{field} is {value}"):
        StreamConfig(**{field: value})  # type: ignore[arg-type]


def test_payloads_of_another_profile_are_errors_or_faces_that_are_bounded() -> None:
    decoder = LatentDecoder(other_profile())
    shown: list[DecodedFrame] = []
    for frame in perform(num_frames=120):
        try:
            shown += deliver(decoder, frame)
        except LatentError:
            continue
    assert all(np.abs(face.sample.latent).max() <= 256 for face in shown)


@pytest.mark.parametrize("quality", range(7))
def test_every_quality_costs_more_and_errs_less_than_the_one_below(quality: int) -> None:
    faces, poses = toy_faces(1, 300), toy_pose(1, 300)

    def cost_and_error(level: int) -> tuple[int, float]:
        publisher = Publisher(StreamConfig(quality=level))
        publisher.show_all(faces, poses)
        shown = {f.number: f for f in deliver_all(LatentDecoder(toy_profile()), publisher.sent)}
        offsets = np.stack(
            [
                shown[frame.number].sample.latent - faces[round(frame.captured_us * 3e-5)]
                for frame in publisher.sent
            ]
        ).reshape(-1, 256)
        # As the picture shows them.
        along = offsets @ toy_metric().directions.T * np.sqrt(np.diag(toy_metric().gram))
        num_bytes = sum(len(frame.payload) for frame in publisher.sent)
        return num_bytes, float(np.square(along).sum(axis=1).mean())

    coarse, fine = cost_and_error(quality), cost_and_error(quality + 1)
    assert coarse[0] < fine[0]
    assert coarse[1] > fine[1]
