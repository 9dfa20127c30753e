"""The bench of one head: its rows and its ratios."""

from typing import Any

import pytest

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.bench.decode import DecodeBenchConfig, run_decode_bench
from pica_core.avatar.spec import AvatarSpec

pytestmark = [pytest.mark.render, pytest.mark.slow]

TOY = with_toy_levels(
    make_toy_avatar(spec=AvatarSpec(uv_encoding_size=16, axis_encoding_size=20), grid=8)
)


@pytest.fixture(scope="module")
def result() -> dict[str, Any]:
    config = DecodeBenchConfig(rounds=3, image_size=96)
    return run_decode_bench(config, TOY)


def rows_of(result: dict[str, Any], **wanted: Any) -> list[dict[str, Any]]:
    return [row for row in result["rows"] if all(row[key] == wanted[key] for key in wanted)]


def test_every_level_is_decoded_whole_and_in_part_and_drawn_beside_the_baseline(
    result: dict[str, Any],
) -> None:
    decodes = [(row["level"], row["parts"]) for row in rows_of(result, work="decode")]
    wanted = [(level, parts) for level in TOY.levels for parts in ("both", "expression")]
    assert decodes == [*wanted, (None, None)]
    drawn = [row["level"] for row in rows_of(result, work="draw", distance_cm=65.0)]
    assert drawn == [*TOY.levels, None]
    assert all(0 < row["ms"] <= row["p95"] for row in result["rows"])


def test_drawings_count_pixels_and_triangles(result: dict[str, Any]) -> None:
    for near, far in zip(
        *(rows_of(result, work="draw", distance_cm=cm) for cm in (18.0, 120.0)), strict=True
    ):
        assert 0 < far["pixels"] < 0.4 * near["pixels"]
    for row in rows_of(result, work="draw", model="pica"):
        assert row["triangles"] == len(TOY.level_faces(row["level"]))


def test_the_result_has_the_ratios_of_every_level(result: dict[str, Any]) -> None:
    ratios = result["baseline_ratio"]
    assert set(ratios) == {"64", "128", "256"}
    assert all(value > 0 for value in ratios.values())
