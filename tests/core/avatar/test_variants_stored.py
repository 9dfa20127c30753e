"""What an avatar loses in its file, precision by precision."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.toy import make_toy_avatar
from pica_core.avatar.spec import AvatarSpec
from pica_core.avatar.storage import DEFAULT_STORAGE, storage_of
from pica_core.reference.precision import PrecisionCost, measure_precisions

pytestmark = pytest.mark.unit

TOY = make_toy_avatar(
    spec=AvatarSpec(
        map_size=64, hidden_channels=(8, 8), uv_encoding_size=64, axis_encoding_size=100
    ),
    grid=12,
)


@pytest.fixture(scope="module")
def costs() -> dict[str, PrecisionCost]:
    return {cost.precision: cost for cost in measure_precisions(TOY, frames=3)}


def test_floats_lose_nothing(costs: dict[str, PrecisionCost]) -> None:
    assert costs["f32"].mse == 0
    assert costs["f32"].flicker_mse == 0
    assert costs["f32"].position_error_um == 0


def test_fewer_bits_make_smaller_files_and_larger_errors(costs: dict[str, PrecisionCost]) -> None:
    falling = [costs[name].bytes for name in ("f32", "f16", "u8")]
    rising = [costs[name].mse for name in ("f32", "f16", "u8")]

    assert falling == sorted(falling, reverse=True)
    assert rising == sorted(rising)
    assert costs["u8"].mse > 0
    assert costs["u8"].flicker_mse > 0


def test_the_usual_storage_is_the_mixed_one() -> None:
    assert storage_of("mixed", TOY.tensors) == dict(DEFAULT_STORAGE)


def test_sine_networks_and_triangles_are_never_rounded() -> None:
    kinds = storage_of("u8", TOY.tensors)

    assert not any(name.startswith(("xyz.", "pixel.")) for name in kinds)
    assert "mesh.faces" not in kinds
    assert kinds["mesh.vertex_uv"] == "u16"
    assert {kinds[name] for name in kinds if name.startswith("geometry.0")} == {"u8"}


def test_the_same_seed_measures_the_same(costs: dict[str, PrecisionCost]) -> None:
    again = {cost.precision: cost for cost in measure_precisions(TOY, frames=3)}
    assert np.isclose(again["u8"].mse, costs["u8"].mse)
