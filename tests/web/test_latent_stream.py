"""The page decodes the golden streams as Python does, and writes what Python reads."""

import json

import numpy as np
import pytest

from golden.stream_vectors import GOLDEN, LATENT_UNIT, read_profile, units_hash
from helpers.page import Handle, Page, PageError
from helpers.stream_toy import toy_faces
from pica_core.codec.latent_stream import LatentEncoder
from pica_core.codec.profile import NUM_TABLES, coefficient_frequencies

pytestmark = pytest.mark.unit

VECTORS = json.loads(GOLDEN.read_text())


@pytest.fixture(scope="module")
def profile(page: Page) -> Handle:
    tensors = {f"stream.{name}": each["values"] for name, each in VECTORS["profile"].items()}
    return page.call("latent_stream", "StreamProfile", {"lookup": tensors})


def test_the_golden_streams_are_decoded(page: Page, profile: Handle) -> None:
    for frames in VECTORS["streams"].values():
        for frame in frames:
            payload = bytes.fromhex(frame["payload"])
            found = page.call("latent_stream", "decodeFrame", profile, payload)
            assert found["coefficients"] == frame["coefficients"]
            assert found["isStill"] == frame["is_still"]
            face = page.call("latent_stream", "decodeFace", profile, payload)
            units = np.array(face["values"][:256]) / LATENT_UNIT
            assert units_hash(units.astype(np.int64)) == frame["latent_sha256"]


def test_damaged_payloads_are_read_or_refused_alike(page: Page, profile: Handle) -> None:
    for each in VECTORS["damaged"]:
        try:
            payload = bytes.fromhex(each["payload"])
            found = page.call("latent_stream", "decodeFrame", profile, payload)["coefficients"]
        except PageError:
            found = None
        assert found == each["coefficients"]


def test_all_tables_are_those_of_python(page: Page) -> None:
    call = page.call
    found = [call("latent_stream", "coefficientTable", n) for n in range(NUM_TABLES)]
    assert [each["frequencies"] for each in found] == coefficient_frequencies().tolist()


def test_faces_are_written_as_python_writes_them(page: Page, profile: Handle) -> None:
    encoder = LatentEncoder(read_profile(VECTORS))
    rng = np.random.default_rng(3)
    wild = [scale * rng.standard_normal((8, 8, 4)) for scale in (0.0, 0.3, 3.0, 200.0)]
    for scale, values in zip(
        (0.0, 0.3, 3.0, 200.0, *[0.1] * 30), (*wild, *toy_faces(5, 30)), strict=True
    ):
        latent = values.astype(np.float32)
        rotation, translation = (scale * rng.standard_normal((2, 3))).astype(np.float32)
        encoder.restart()
        expected = encoder.encode(latent, rotation, translation, 0)
        face = np.concatenate([latent.ravel(), rotation, translation])
        assert expected is not None
        assert page.call("latent_stream", "encodeFace", profile, face) == expected.payload
