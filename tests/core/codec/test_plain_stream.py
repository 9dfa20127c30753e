"""The plain latent payload: small errors, one payload per sample, and no bytes that surprise."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.paths import ROOT
from pica_core.codec.plain_stream import (
    PLAIN_BYTES,
    decode_latent,
    encode_latent,
)
from pica_core.errors import LatentError, ShapeError

pytestmark = pytest.mark.unit

SCALE = (0.5, 1.0, 2.0, 4.0)
STILL = np.zeros(3)


def some_sample(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    latent = rng.uniform(-1, 1, (8, 8, 4)) * SCALE
    return latent, rng.uniform(-3, 3, 3), rng.uniform(-1, 1, 3)


def test_a_payload_has_269_bytes_and_starts_with_its_format() -> None:
    payload = encode_latent(*some_sample(0), SCALE)
    assert len(payload) == PLAIN_BYTES == 269
    assert payload[0] == 1


@settings(max_examples=100, derandomize=True, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_sample_comes_back_within_half_a_step(seed: int) -> None:
    latent, rotation, translation_m = some_sample(seed)
    sample = decode_latent(encode_latent(latent, rotation, translation_m, SCALE), SCALE)
    half_step = np.asarray(SCALE) / 127 / 2
    assert (np.abs(sample.latent - latent) <= half_step * 1.0001).all()
    assert np.abs(sample.rotation - rotation).max() <= np.pi / 32767 * 0.501
    assert np.abs(sample.translation_m - translation_m).max() <= 1 / 32767 * 0.501


@settings(max_examples=100, derandomize=True, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_encoding_what_was_decoded_gives_the_same_bytes(seed: int) -> None:
    payload = encode_latent(*some_sample(seed), SCALE)
    sample = decode_latent(payload, SCALE)
    again = encode_latent(sample.latent, sample.rotation, sample.translation_m, SCALE)
    assert again == payload


@settings(max_examples=300, derandomize=True, deadline=None)
@given(
    payload=st.one_of(
        st.binary(max_size=300),
        st.binary(min_size=268, max_size=268).map(lambda rest: b"\x01" + rest),
    )
)
def test_any_bytes_decode_to_finite_values_or_raise_a_latent_error(payload: bytes) -> None:
    try:
        sample = decode_latent(payload, SCALE)
    except LatentError:
        return
    assert sample.latent.shape == (8, 8, 4)
    assert np.isfinite(sample.latent).all()
    assert np.abs(sample.translation_m).max() <= 1


def test_values_beyond_the_range_are_clamped() -> None:
    payload = encode_latent(np.full((8, 8, 4), 1e6), STILL, [9.0, -9.0, 0.0], SCALE)
    sample = decode_latent(payload, SCALE)
    np.testing.assert_allclose(sample.latent[0, 0], SCALE, rtol=1e-6)
    np.testing.assert_allclose(sample.translation_m, [1, -1, 0])


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_value_that_is_not_finite_is_not_sent(value: float) -> None:
    with pytest.raises(LatentError, match="latent holds a value that is not finite"):
        encode_latent(np.full((8, 8, 4), value), STILL, STILL, SCALE)
    with pytest.raises(LatentError, match="rotation"):
        encode_latent(np.zeros((8, 8, 4)), [0, value, 0], STILL, SCALE)


def test_a_latent_of_another_shape_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"latent is \(4, 8, 8\)"):
        encode_latent(np.zeros((4, 8, 8)), STILL, STILL, SCALE)


@pytest.mark.parametrize(
    ("payload", "message"),
    [
        (b"", "empty"),
        (b"\x02" + bytes(268), "format is 2"),
        (b"\x01" + bytes(267), "has 268 bytes"),
        (b"\x01" + bytes(269), "has 270 bytes"),
        (b"\x01\x80\x00" + bytes(266), "no encoder writes"),
        (b"\x01" + bytes(267) + b"\x80", "no encoder writes"),
    ],
)
def test_bytes_that_no_encoder_writes_are_refused(payload: bytes, message: str) -> None:
    with pytest.raises(LatentError, match=message):
        decode_latent(payload, SCALE)


def test_the_payload_that_the_page_shows_is_the_one_of_its_face() -> None:
    page = (ROOT / "docs" / "bitstream.md").read_text()
    (shown,) = re.findall(r"```hex\n(.*?)```", page, re.DOTALL)
    codes = np.maximum(np.arange(-128, 128), -127).reshape(8, 8, 4)
    latent = codes / 127 * SCALE
    rotation = np.array([16384, -32767, 0]) * np.pi / 32767
    translation_m = np.array([3277, -1, 32767]) / 32767
    assert encode_latent(latent, rotation, translation_m, SCALE) == bytes.fromhex(shown)
    sample = decode_latent(bytes.fromhex(shown), SCALE)
    np.testing.assert_allclose(sample.latent, latent, rtol=1e-6)
    np.testing.assert_allclose(sample.rotation, rotation, rtol=1e-6)
    np.testing.assert_allclose(sample.translation_m, translation_m, rtol=1e-6)
