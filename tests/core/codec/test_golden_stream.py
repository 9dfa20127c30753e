"""The bytes of the bitstream: golden payloads give golden numbers, in both decoders."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from golden import second_decoder
from golden.stream_vectors import (
    GOLDEN,
    QUALITIES,
    decoded,
    encode_stream,
    latent_units,
    read_profile,
    units_hash,
)
from pica_core.codec.latent_stream import LatentDecoder, decode_frame

pytestmark = pytest.mark.unit

VECTORS = json.loads(GOLDEN.read_text())
PROFILE = read_profile(VECTORS)
FRAMES: list[dict[str, Any]] = [f for frames in VECTORS["streams"].values() for f in frames]


def nested(array: dict[str, Any]) -> Any:
    return np.array(array["values"]).reshape(array["shape"]).tolist()


LISTS = {name: nested(array) for name, array in VECTORS["profile"].items()}


def test_the_profile_has_its_golden_name() -> None:
    assert PROFILE.hash == VECTORS["profile_hash"]
    assert second_decoder.profile_hash(VECTORS["profile"]) == PROFILE.hash


@pytest.mark.parametrize("quality", QUALITIES)
def test_golden_faces_encode_to_golden_payloads(quality: int) -> None:
    made = [(frame.multiple, frame.payload.hex()) for frame in encode_stream(VECTORS, quality)]
    golden = VECTORS["streams"][str(quality)]
    assert made == [(frame["multiple"], frame["payload"]) for frame in golden]


def test_golden_payloads_decode_to_golden_faces() -> None:
    for frame in FRAMES:
        payload = bytes.fromhex(frame["payload"])
        coefficients, is_still = decode_frame(PROFILE, payload)
        assert (coefficients.tolist(), is_still) == (frame["coefficients"], frame["is_still"])
        assert units_hash(latent_units(PROFILE, coefficients)) == frame["latent_sha256"]
        pose = np.array(frame["coefficients"][-6:]) / 16384
        np.testing.assert_array_equal(LatentDecoder(PROFILE).decode(payload).rotation, pose[:3])


def test_a_second_decoder_written_from_the_page_agrees() -> None:
    for frame in FRAMES:
        coefficients, is_still = second_decoder.decode(LISTS, bytes.fromhex(frame["payload"]))
        assert (coefficients, is_still) == (frame["coefficients"], frame["is_still"])
        units = second_decoder.latent_units(LISTS, coefficients)
        assert units_hash(units) == frame["latent_sha256"]


def test_damaged_payloads_give_golden_numbers_or_are_refused_by_both() -> None:
    for entry in VECTORS["damaged"]:
        payload = bytes.fromhex(entry["payload"])
        assert decoded(PROFILE, payload) == entry["coefficients"]
        try:
            second: list[int] | None = second_decoder.decode(LISTS, payload)[0]
        except second_decoder.DamagedError:
            second = None
        assert second == entry["coefficients"]
