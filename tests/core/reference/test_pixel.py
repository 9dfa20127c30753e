"""The numpy pixel decoder: sampling rules, sizes, and agreement with a plain loop."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.toy import make_toy_avatar
from pica_core.errors import ShapeError
from pica_core.reference import (
    count_parameters,
    decode_pixels,
    pixel_inputs,
)
from pica_core.sampling import sample_bilinear, sample_linear

pytestmark = pytest.mark.unit

TOY = make_toy_avatar(grid=4)


def some_pixels(count: int, seed: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    expression = rng.standard_normal((count, 4))
    xyz_m = rng.uniform(-0.1, 0.1, (count, 3))
    return expression, xyz_m, rng.uniform(0, 1, (count, 2))


def test_the_pixel_decoder_has_307_parameters_and_the_xyz_siren_36() -> None:
    assert count_parameters(TOY.tensors, "pixel") == 307
    assert count_parameters(TOY.tensors, "xyz") == 36


def test_a_texel_centre_gives_the_texel() -> None:
    texture = np.arange(24, dtype=np.float32).reshape(3, 4, 2)
    for row in range(3):
        for column in range(4):
            uv = np.array([(column + 0.5) / 4, (row + 0.5) / 3])
            np.testing.assert_allclose(
                sample_bilinear(texture, uv), texture[row, column], atol=1e-5
            )


@pytest.mark.parametrize("uv", [(-3.0, 0.5), (0.0, 0.5), (0.1, 0.5)])
def test_outside_the_centres_the_edge_continues(uv: tuple[float, float]) -> None:
    texture = np.array([[[5.0], [7.0], [9.0]]], np.float32)
    assert sample_bilinear(texture, uv)[0] == 5.0


@settings(max_examples=50, derandomize=True, deadline=None)
@given(
    u=st.floats(0, 1),
    v=st.floats(0, 1),
    height=st.integers(1, 5),
    width=st.integers(1, 5),
)
def test_weights_of_a_sample_add_up_to_one(u: float, v: float, height: int, width: int) -> None:
    texture = np.full((height, width, 1), 3.25)
    assert sample_bilinear(texture, [u, v], np.float64)[0] == pytest.approx(3.25, rel=1e-12)


def test_p_is_expression_then_position_then_surface() -> None:
    expression, xyz_m, uv = some_pixels(5)
    p = pixel_inputs(TOY.spec, TOY.tensors, expression, xyz_m, uv, np.float64)
    assert p.shape == (5, 16)
    np.testing.assert_array_equal(p[:, :4], expression)
    assert np.abs(p[:, 4:8]).max() <= 1  # sines
    m_uv = sample_bilinear(TOY.tensors["uv_encoding"], uv, np.float64)
    np.testing.assert_array_equal(p[:, 8:12], m_uv)
    m_v = sample_linear(TOY.tensors["v_encoding"], uv[:, 1], np.float64)
    np.testing.assert_array_equal(p[:, 14:], m_v)


def test_decoding_agrees_with_one_pixel_computed_by_hand() -> None:
    expression, xyz_m, uv = some_pixels(1)
    p = pixel_inputs(TOY.spec, TOY.tensors, expression, xyz_m, uv, np.float64)[0]
    values = list(p)
    for layer in range(4):
        weight, bias = (TOY.tensors[f"pixel.{layer}.{part}"] for part in ("weight", "bias"))
        sums = [
            float(bias[row]) + sum(float(weight[row, k]) * values[k] for k in range(len(values)))
            for row in range(len(weight))
        ]
        values = sums if layer == 3 else [float(np.sin(value)) for value in sums]
    decoded = decode_pixels(TOY.spec, TOY.tensors, expression, xyz_m, uv, np.float64)[0]
    np.testing.assert_allclose(decoded, values, rtol=1e-12)


def test_float32_stays_within_rounding_of_float64() -> None:
    pixels = some_pixels(2000)
    single = decode_pixels(TOY.spec, TOY.tensors, *pixels)
    double = decode_pixels(TOY.spec, TOY.tensors, *pixels, np.float64)
    assert single.dtype == np.float32
    assert double.dtype == np.float64
    assert np.abs(single - double).max() < 2e-5


def test_a_map_without_channels_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"\[H, W, C\]"):
        sample_bilinear(np.zeros((3, 3)), [0.5, 0.5])
