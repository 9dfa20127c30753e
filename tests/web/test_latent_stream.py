"""The page decodes the golden streams as Python does, and writes what Python reads."""

import json

import numpy as np
import pytest

from golden.stream_vectors import GOLDEN
from helpers.page import Page, PageError
from helpers.stream_toy import toy_decoder, toy_faces
from helpers.toy import make_toy_avatar
from pica_core.codec.latent_stream import LatentEncoder

pytestmark = pytest.mark.unit

VECTORS = json.loads(GOLDEN.read_text())


def test_the_golden_streams_are_decoded(page: Page) -> None:
    for frames in VECTORS["streams"].values():
        for frame in frames:
            found = page.call("latent_stream", "decodeFrame", bytes.fromhex(frame["payload"]))
            assert found["coefficients"] == frame["coefficients"]
            assert found["isStill"] == frame["is_still"]


def test_what_is_left_of_latents_is_read(page: Page) -> None:
    for entry in VECTORS["rests"]:
        found = page.call("latent_stream", "decodeFrame", bytes.fromhex(entry["payload"]))
        assert found["coefficients"] == entry["coefficients"]


def test_a_decoded_face_is_that_of_python(page: Page) -> None:
    tensors = make_toy_avatar().tensors
    layers = {name: array for name, array in tensors.items() if name.startswith("encoder.")}
    encoder = page.call("latent_stream", "openEncoder", {"floats": {"lookup": layers}})
    for frame in VECTORS["streams"]["2"][:5]:
        payload = bytes.fromhex(frame["payload"])
        sample = toy_decoder().decode(payload)
        true = np.concatenate([sample.latent.ravel(), sample.rotation, sample.translation_m])
        found = page.call("latent_stream", "decodeFace", encoder, payload)
        assert np.array(found["values"]) == pytest.approx(true, abs=1e-4)


def test_damaged_payloads_are_read_or_refused_alike(page: Page) -> None:
    for each in VECTORS["damaged"]:
        try:
            payload = bytes.fromhex(each["payload"])
            found = page.call("latent_stream", "decodeFrame", payload)["coefficients"]
        except PageError:
            found = None
        assert found == each["coefficients"]


def test_faces_are_written_as_python_writes_them(page: Page) -> None:
    encoder = LatentEncoder()
    rng = np.random.default_rng(3)
    wild = [scale * rng.standard_normal(52) for scale in (0.0, 0.3, 3.0, 200.0)]
    for scale, values in zip(
        (0.0, 0.3, 3.0, 200.0, *[0.1] * 30), (*wild, *toy_faces(5, 30)), strict=True
    ):
        arkit = values.astype(np.float32)
        rotation, translation = (scale * rng.standard_normal((2, 3))).astype(np.float32)
        encoder.restart()
        expected = encoder.encode(arkit, rotation, translation, 0)
        face = np.concatenate([arkit, rotation, translation])
        assert expected is not None
        assert page.call("latent_stream", "encodeFace", face) == expected.payload
