"""The numpy pixel decoder: sampling rules, sizes, and agreement with a plain loop."""

import numpy as np
import pytest

from helpers.toy import make_toy_avatar
from pica_core.reference import count_parameters, decode_pixels, encode_surface
from pica_core.sampling import sample_bilinear

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


def test_decoding_agrees_with_one_pixel_computed_by_hand() -> None:
    expression, xyz_m, uv = some_pixels(1)

    def layer(name: str, values: list[float]) -> list[float]:
        weight, bias = (TOY.tensors[f"{name}.{part}"] for part in ("weight", "bias"))
        return [
            float(bias[row]) + sum(float(weight[row, k]) * values[k] for k in range(len(values)))
            for row in range(len(weight))
        ]

    values = list(xyz_m[0])
    for index in range(2):
        values = [float(np.sin(value)) for value in layer(f"xyz.{index}", values)]
    surface = encode_surface(TOY.spec, TOY.tensors, uv, np.float64)[0]
    values = [*expression[0], *values, *surface]
    for index in range(4):
        values = layer(f"pixel.{index}", values)
        values = values if index == 3 else [float(np.sin(value)) for value in values]
    decoded = decode_pixels(TOY.spec, TOY.tensors, expression, xyz_m, uv, np.float64)[0]
    np.testing.assert_allclose(decoded, values, rtol=1e-12)
