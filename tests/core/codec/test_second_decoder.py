"""Two decoders, one from the other's page: they agree on every golden vector, to the bit."""

from __future__ import annotations

import json
import random
from typing import Any

import pytest

from golden.second_decoder import (
    DamagedError,
    Decoded,
    MissingError,
    decode,
    latent_units,
    profile_hash,
)
from golden.stream_vectors import GOLDEN, read_profile, units_hash
from pica_core.codec.frames import FrameState, decode_frame
from pica_core.errors import LatentError, MissingReferenceError

pytestmark = pytest.mark.unit

VECTORS = json.loads(GOLDEN.read_text())
ARRAYS = {name: array.tolist() for name, array in vars(read_profile(VECTORS)).items()}
STREAMS = [(name, stream["frames"]) for name, stream in VECTORS["streams"].items()]
STREAMS += [(f"older {index}", stream["frames"]) for index, stream in enumerate(VECTORS["older"])]


def decode_stream(frames: list[dict[str, Any]]) -> dict[int, Decoded]:
    """Every frame of a golden stream, by number."""
    kept: dict[int, Decoded] = {}
    for number, frame in enumerate(frames, start=frames[0]["sequence"]):
        kept[number] = decode(
            ARRAYS,
            bytes.fromhex(frame["payload"]),
            number=number,
            layer=frame["layer"],
            is_keyframe=frame["is_keyframe"],
            kept=kept,
        )
    return kept


@pytest.mark.parametrize(("name", "frames"), STREAMS, ids=[name for name, _ in STREAMS])
def test_the_second_decoder_reads_golden_streams(name: str, frames: list[dict[str, Any]]) -> None:
    for decoded, frame in zip(decode_stream(frames).values(), frames, strict=True):
        assert decoded.c == frame["coefficients"]
        assert (decoded.quality, decoded.is_still) == (frame["quality"], frame["is_still"])
        assert units_hash(latent_units(ARRAYS, decoded.c)) == frame["latent_sha256"]


def test_the_second_decoder_refuses_what_the_first_refuses() -> None:
    streams = {name: decode_stream(frames) for name, frames in STREAMS}
    for entry in VECTORS["damaged"]:
        frames = VECTORS["streams"][entry["stream"]]["frames"]
        number, frame = frames[0]["sequence"] + entry["frame"], frames[entry["frame"]]
        try:
            decoded = decode(
                ARRAYS,
                bytes.fromhex(entry["payload"]),
                number=number,
                layer=frame["layer"],
                is_keyframe=frame["is_keyframe"],
                kept={n: d for n, d in streams[entry["stream"]].items() if n < number},
            )
        except (DamagedError, MissingError):
            assert entry["coefficients"] is None
        else:
            assert decoded.c == entry["coefficients"]


def test_both_decoders_agree_on_noise() -> None:
    rng = random.Random(12)
    profile = read_profile(VECTORS)
    kept = decode_stream(STREAMS[0][1][:20])
    references: dict[int, FrameState] = {}
    for number, frame in enumerate(STREAMS[0][1][:20]):
        references[number], _ = decode_frame(
            profile,
            bytes.fromhex(frame["payload"]),
            sequence=number,
            layer=frame["layer"],
            is_keyframe=frame["is_keyframe"],
            references=references,
        )
    outcomes = {"read": 0, "damaged": 0, "missing": 0}
    for _ in range(1500):
        payload = rng.choice([b"", b"\xff", b"\xff\xff\xff"]) + rng.randbytes(rng.randint(0, 24))
        number, layer, is_keyframe = rng.randint(18, 28), rng.randint(0, 3), rng.random() < 0.2
        first: list[int] | str
        second: list[int] | str
        try:
            state, _ = decode_frame(
                profile,
                payload,
                sequence=number,
                layer=layer,
                is_keyframe=is_keyframe,
                references=references,
            )
            first, outcome = [*state.coefficients.tolist(), *state.motion.tolist()], "read"
        except MissingReferenceError:
            first = outcome = "missing"
        except LatentError:
            first = outcome = "damaged"
        try:
            decoded = decode(
                ARRAYS, payload, number=number, layer=layer, is_keyframe=is_keyframe, kept=kept
            )
            second = [*decoded.c, *decoded.m]
        except MissingError:
            second = "missing"
        except DamagedError:
            second = "damaged"
        assert first == second
        outcomes[outcome] += 1
    assert min(outcomes.values()) > 50


def test_the_profile_is_named_as_the_page_says() -> None:
    assert profile_hash(VECTORS["profile"]) == VECTORS["profile_hash"]
