"""The chart of error against milliseconds: what its rows say, and which of them are best."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.bench.pareto import (
    ParetoBenchConfig,
    mark_best,
    run_pareto_bench,
    with_precision,
)
from pica_client.errors import OptionError
from pica_core.avatar.spec import BLOCKS

pytestmark = pytest.mark.render


@pytest.fixture(scope="module")
def rows() -> list[dict[str, Any]]:
    config = ParetoBenchConfig(distances_cm=(65.0,), image_size=64, frames=3)
    result = run_pareto_bench(config, with_toy_levels(make_toy_avatar()))
    found: list[dict[str, Any]] = result["rows"]
    return found


def row_of(rows: list[dict[str, Any]], **wanted: Any) -> dict[str, Any]:
    (found,) = [row for row in rows if all(row[key] == wanted[key] for key in wanted)]
    return found


def test_the_full_level_leaves_less_error_than_exits_of_random_weights(
    rows: list[dict[str, Any]],
) -> None:
    full, coarse = (
        row_of(rows, model="pica", level=level, mesh=level, precision="f32") for level in (256, 64)
    )
    assert full["mse"] < coarse["mse"]


def test_half_precision_is_nearer_to_the_truth_than_eight_bits(rows: list[dict[str, Any]]) -> None:
    half, bytes_ = (
        row_of(rows, model="pica", level=256, mesh=256, precision=precision)
        for precision in ("f16", "u8")
    )
    assert half["mse"] <= bytes_["mse"]
    assert half["file_bytes"] > bytes_["file_bytes"]


def test_other_blocks_have_a_cost_and_no_error(rows: list[dict[str, Any]]) -> None:
    for block in set(BLOCKS) - {make_toy_avatar().spec.block}:
        row = row_of(rows, model=f"block {block}")
        assert row["decode_ms"] > 0
        assert row["mse"] is None
        assert not row["is_best"]


def test_best_is_what_nothing_beats_in_both_cost_and_error() -> None:
    def row(total_ms: float, mse: float | None, distance_cm: float = 65.0) -> dict[str, Any]:
        return {"total_ms": total_ms, "mse": mse, "distance_cm": distance_cm}

    marked = mark_best(
        [row(1, 9), row(2, 4), row(3, 4), row(4, 1), row(2.02, 5), row(9, 8, 18.0), row(1, None)]
    )
    assert [each["is_best"] for each in marked] == [True, True, False, True, False, True, False]


def test_weights_in_eight_bits_come_back_changed_and_maps_as_they_were() -> None:
    avatar = make_toy_avatar()
    stored, _ = with_precision(avatar, "u8")
    name = "geometry.0.first.weight"
    assert not np.array_equal(stored.tensors[name], avatar.tensors[name])
    assert np.allclose(stored.tensors[name], avatar.tensors[name], atol=0.05)
    whole, _ = with_precision(avatar, "f32")
    assert np.array_equal(whole.tensors[name], avatar.tensors[name])


@pytest.mark.parametrize("changes", [{"distances_cm": ()}, {"image_size": 8}, {"frames": 0}])
def test_settings_out_of_range_are_refused_by_name(changes: dict[str, Any]) -> None:
    with pytest.raises(OptionError, match=next(iter(changes))):
        ParetoBenchConfig(**changes)
