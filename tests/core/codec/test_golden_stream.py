"""The bytes of the bitstream: golden payloads give golden numbers, in both decoders."""

from __future__ import annotations

import json
import runpy
from typing import Any

import numpy as np
import pytest

from golden.stream_vectors import (
    GOLDEN,
    QUALITIES,
    decoded,
    encode_stream,
    latent_units,
    made_vectors,
    read_profile,
    units_hash,
)
from helpers.paths import ROOT
from pica_core.codec.latent_stream import LatentDecoder, decode_frame

pytestmark = pytest.mark.unit

VECTORS = json.loads(GOLDEN.read_text())
PROFILE = read_profile(VECTORS)
FRAMES: list[dict[str, Any]] = [f for frames in VECTORS["streams"].values() for f in frames]


SECOND = runpy.run_path(str(ROOT / "examples" / "24_decode_without_pica.py"))
"""A second decoder; as an example it decodes what is not damaged."""
LISTS = {
    name: np.array(array["values"]).reshape(array["shape"]).tolist()
    for name, array in VECTORS["profile"].items()
} | VECTORS["fixed"]


def test_what_is_the_same_for_all_profiles_is_golden() -> None:
    assert json.loads(json.dumps(made_vectors()["fixed"])) == VECTORS["fixed"]


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


def test_damaged_payloads_give_golden_numbers_or_are_refused_by_both() -> None:
    for entry in VECTORS["damaged"]:
        payload = bytes.fromhex(entry["payload"])
        assert decoded(PROFILE, payload) == entry["coefficients"]
        try:
            second = SECOND["decode_frame"](LISTS, payload)[0]
        except ValueError:
            second = None
        assert second == entry["coefficients"]
