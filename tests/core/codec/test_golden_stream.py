"""The bytes of the bitstream: golden payloads give golden numbers, in both decoders."""

import json
import runpy
from typing import Any

import numpy as np
import pytest

from golden.stream_vectors import GOLDEN, QUALITIES, decoded, encode_stream, made_vectors
from helpers.paths import ROOT
from helpers.stream_toy import toy_decoder
from helpers.toy import make_toy_avatar
from pica_core.avatar.expression_encoder import ExpressionEncoder
from pica_core.codec.latent_stream import decode_frame

pytestmark = pytest.mark.unit

VECTORS = json.loads(GOLDEN.read_text())
FRAMES: list[dict[str, Any]] = [f for frames in VECTORS["streams"].values() for f in frames]


SECOND = runpy.run_path(str(ROOT / "examples" / "24_decode_without_pica.py"))
"""A second decoder; as an example it decodes what is not damaged."""


def test_the_tables_are_golden() -> None:
    assert json.loads(json.dumps(made_vectors()["fixed"])) == VECTORS["fixed"]


@pytest.mark.parametrize("quality", QUALITIES)
def test_golden_faces_encode_to_golden_payloads(quality: int) -> None:
    made = [(frame.multiple, frame.payload.hex()) for frame in encode_stream(VECTORS, quality)]
    golden = VECTORS["streams"][str(quality)]
    assert made == [(frame["multiple"], frame["payload"]) for frame in golden]


def test_golden_payloads_decode_to_golden_faces() -> None:
    expressions = ExpressionEncoder(make_toy_avatar())
    for frame in FRAMES:
        payload = bytes.fromhex(frame["payload"])
        coefficients, is_still = decode_frame(payload)
        assert (coefficients.tolist(), is_still) == (frame["coefficients"], frame["is_still"])
        sample = toy_decoder().decode(payload)
        np.testing.assert_array_equal(
            sample.latent, expressions.encode(np.array(frame["coefficients"][:52]) / 4096)
        )
        np.testing.assert_array_equal(
            sample.rotation, np.array(frame["coefficients"][52:55]) / 16384
        )


def test_what_is_left_of_latents_is_read_by_both() -> None:
    for entry in VECTORS["rests"]:
        payload = bytes.fromhex(entry["payload"])
        assert decoded(payload) == entry["coefficients"]
        assert SECOND["decode_frame"](VECTORS["fixed"], payload)[0] == entry["coefficients"]


def test_damaged_payloads_give_golden_numbers_or_are_refused_by_both() -> None:
    for entry in VECTORS["damaged"]:
        payload = bytes.fromhex(entry["payload"])
        assert decoded(payload) == entry["coefficients"]
        try:
            second = SECOND["decode_frame"](VECTORS["fixed"], payload)[0]
        except ValueError:
            second = None
        assert second == entry["coefficients"]
