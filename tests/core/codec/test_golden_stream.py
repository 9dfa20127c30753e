"""The bytes of the bitstream, for ever: golden payloads decode to golden numbers, to the bit."""

from __future__ import annotations

import hashlib
import json
from typing import Any

import numpy as np
import pytest

from golden.stream_vectors import (
    CONFIGS,
    GOLDEN,
    encode_stream,
    latent_units,
    read_profile,
    renewed,
    to_text,
    units_hash,
)
from pica_core.codec.frames import FrameState, decode_frame
from pica_core.codec.latent_sample import ReceivedFrame
from pica_core.codec.latent_stream import LatentDecoder
from pica_core.errors import LatentError

pytestmark = pytest.mark.unit

VECTORS = json.loads(GOLDEN.read_text())
PROFILE = read_profile(VECTORS)
STREAMS = [(name, stream["frames"]) for name, stream in VECTORS["streams"].items()]
STREAMS += [(f"older {index}", stream["frames"]) for index, stream in enumerate(VECTORS["older"])]


def states(frames: list[dict[str, Any]]) -> list[FrameState]:
    """Decode a golden stream frame by frame."""
    references: dict[int, FrameState] = {}
    decoded = []
    for number, frame in numbered(frames):
        state, is_still = decode_frame(
            PROFILE,
            bytes.fromhex(frame["payload"]),
            sequence=number,
            layer=frame["layer"],
            is_keyframe=frame["is_keyframe"],
            references=references,
        )
        assert is_still == frame["is_still"]
        references[number] = state
        decoded.append(state)
    return decoded


def numbered(frames: list[dict[str, Any]]) -> list[tuple[int, dict[str, Any]]]:
    """Frames with numbers that do not wrap."""
    return [(frames[0]["sequence"] + index, frame) for index, frame in enumerate(frames)]


def test_the_profile_has_its_golden_name() -> None:
    assert PROFILE.hash == VECTORS["profile_hash"]


@pytest.mark.parametrize(("name", "frames"), STREAMS, ids=[name for name, _ in STREAMS])
def test_golden_payloads_decode_to_golden_numbers(name: str, frames: list[dict[str, Any]]) -> None:
    for state, frame in zip(states(frames), frames, strict=True):
        assert state.coefficients.tolist() == frame["coefficients"]
        assert state.quality == frame["quality"]
        assert units_hash(latent_units(PROFILE, state.coefficients)) == frame["latent_sha256"]


@pytest.mark.parametrize(("name", "frames"), STREAMS, ids=[name for name, _ in STREAMS])
def test_a_receiver_shows_every_frame_of_a_golden_stream(
    name: str, frames: list[dict[str, Any]]
) -> None:
    decoder = LatentDecoder(PROFILE)
    for number, frame in enumerate(frames, start=frames[0]["sequence"]):
        assert frame["sequence"] == number % 65536
        received = ReceivedFrame(
            number,
            frame["captured_us"],
            frame["layer"],
            frame["is_keyframe"],
            bytes.fromhex(frame["payload"]),
        )
        (shown,) = decoder.receive(received)
        units = (shown.sample.latent.astype(np.float64) * 4096).astype("<i4")
        assert hashlib.sha256(units.tobytes()).hexdigest() == frame["latent_sha256"]
        pose = np.array(frame["coefficients"][-6:]) / 16384
        np.testing.assert_array_equal(shown.sample.rotation, pose[:3])
        np.testing.assert_array_equal(shown.sample.translation_m, pose[3:])
        assert shown.sample.is_still == frame["is_still"]


@pytest.mark.parametrize("name", CONFIGS)
def test_golden_faces_encode_to_golden_payloads(name: str) -> None:
    payloads = [frame["payload"] for frame in VECTORS["streams"][name]["frames"]]
    assert [frame.payload.hex() for frame in encode_stream(VECTORS, name)] == payloads


def test_full_latents_are_those_of_their_frames() -> None:
    for entry in VECTORS["latents"]:
        frame = VECTORS["streams"][entry["stream"]]["frames"][entry["frame"]]
        assert units_hash(entry["units"]) == frame["latent_sha256"]


def test_damaged_payloads_give_golden_numbers_or_are_refused() -> None:
    decoded = {name: states(stream["frames"]) for name, stream in VECTORS["streams"].items()}
    for entry in VECTORS["damaged"]:
        frames = VECTORS["streams"][entry["stream"]]["frames"]
        number, frame = numbered(frames)[entry["frame"]]
        references = {state.sequence: state for state in decoded[entry["stream"]]}
        try:
            state, _ = decode_frame(
                PROFILE,
                bytes.fromhex(entry["payload"]),
                sequence=number,
                layer=frame["layer"],
                is_keyframe=frame["is_keyframe"],
                references={n: s for n, s in references.items() if n < number},
            )
        except LatentError:
            assert entry["coefficients"] is None
        else:
            assert state.coefficients.tolist() == entry["coefficients"]


def test_the_golden_file_shows_all_that_a_frame_can_be() -> None:
    frames = [frame for _, stream in STREAMS for frame in stream]
    assert {frame["layer"] for frame in frames} == {0, 1, 2}
    assert {frame["is_still"] for frame in frames} == {True, False}
    assert {frame["is_keyframe"] for frame in frames} == {True, False}
    assert min(len(frame["payload"]) for frame in frames) <= 2
    sequences = [frame["sequence"] for _, stream in STREAMS for frame in stream]
    assert {65_535, 0} <= set(sequences)
    refused = [entry["coefficients"] is None for entry in VECTORS["damaged"]]
    assert 20 < sum(refused) < len(refused) - 20


def test_writing_the_file_again_changes_nothing() -> None:
    assert to_text(renewed(VECTORS)) == GOLDEN.read_text()
    assert len(GOLDEN.read_bytes()) < 200_000
