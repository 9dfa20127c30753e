"""The decode bench: everybody in turns, honest rows, ratios of the same round."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from helpers.toy import guessed_errors, make_toy_avatar, with_toy_levels
from pica_client.bench.decode import (
    DecodeBenchConfig,
    export_difference,
    level_for,
    random_decoders,
    run_decode_bench,
    vertex_error_mm,
)
from pica_client.decode.decoder import OnnxOptions
from pica_client.errors import OptionError
from pica_core.avatar.file import Avatar
from pica_core.avatar.spec import BLOCKS, AvatarSpec

pytestmark = [pytest.mark.unit, pytest.mark.slow]

TOY = with_toy_levels(
    make_toy_avatar(spec=AvatarSpec(uv_encoding_size=16, axis_encoding_size=20), grid=8)
)


@pytest.fixture(scope="module")
def result() -> dict[str, Any]:
    config = DecodeBenchConfig(rounds=2, threads=(1,), blocks=("H2",))
    return run_decode_bench(config, TOY)


def test_there_is_a_row_for_every_model_level_and_part(result: dict[str, Any]) -> None:
    rows = [(row["model"], row["level"], row["parts"]) for row in result["rows"]]
    assert sorted(rows, key=str) == sorted(
        [
            *(("pica", level, parts) for level in TOY.levels for parts in ("both", "expression")),
            *(("block H2", level, "both") for level in TOY.levels),
            ("baseline", None, "all"),
            ("talk", 256, "both"),
            ("frame", 256, "both"),
            ("baseline frame", None, "all"),
        ],
        key=str,
    )
    assert all(0 < row["ms"] <= row["p95"] for row in result["rows"])


def test_both_exports_are_equal_wherever_both_were_timed(result: dict[str, Any]) -> None:
    compared = [row for row in result["rows"] if row["plain_ms"] is not None]
    assert len(compared) == 2 * len(TOY.levels)
    assert all(row["is_equal"] and row["difference"] <= 1e-4 for row in compared)


def test_a_level_has_its_error_and_random_weights_have_none(result: dict[str, Any]) -> None:
    errors = guessed_errors(TOY.levels)
    for row in result["rows"]:
        if row["model"] == "pica":
            assert row["mse"] == pytest.approx(errors.at(row["level"], 640.0), abs=2e-3)
            assert (row["vertex_mm"] == 0) == (row["level"] == 256)
        else:
            assert row["mse"] is None
            assert row["vertex_mm"] is None


def test_the_summary_has_the_ratios_of_every_level(result: dict[str, Any]) -> None:
    ratios = result["summary"]["by_threads"]["1"]["pica"]
    assert ratios["level_ratio"]["256"] == 1
    assert ratios["baseline_ratio"]["256"] > 1
    assert set(ratios["plain_ratio"]) == {"64", "128", "256"}
    assert result["summary"]["level_at_head_px"] == 256
    assert result["summary"]["talk_ratio"]["1"] > 1
    assert result["summary"]["frame_ratio"]["1"] > 1


def test_a_frame_says_what_it_made_and_uploaded(result: dict[str, Any]) -> None:
    rows = {row["model"]: row for row in result["rows"]}
    assert rows["frame"]["upload_bytes"] == 256 * 256 * (3 + 4) * 4


def test_an_export_that_differs_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    from pica_client.bench import decode as bench_decode

    latents = [np.random.default_rng(2).standard_normal((8, 8, 4)).astype(np.float32)]
    assert export_difference(TOY, 64, latents, OnnxOptions()) <= 1e-4
    graph = bench_decode.decoder_graph
    other = make_toy_avatar(seed=8, spec=TOY.spec, grid=8)
    levelled = with_toy_levels(other)
    monkeypatch.setattr(
        bench_decode, "decoder_graph", lambda avatar, **options: graph(levelled, **options)
    )
    assert export_difference(TOY, 64, latents, OnnxOptions()) > 1e-3


@pytest.mark.parametrize("block", BLOCKS)
def test_random_decoders_have_every_level_of_their_block(block: str) -> None:
    avatar = random_decoders(TOY, block, seed=1)
    assert (avatar.spec.block, avatar.levels) == (block, TOY.levels)


def test_vertices_of_a_level_are_compared_with_the_full_ones() -> None:
    latents = [np.zeros((8, 8, 4), np.float32)]
    assert vertex_error_mm(TOY, 256, latents) == 0
    moved = dict(TOY.tensors)
    moved["level.64.geometry.mean"] = moved["level.64.geometry.mean"] + np.float32(0.5)
    shifted = Avatar(TOY.manifest, moved)
    further = vertex_error_mm(shifted, 64, latents)
    assert further == pytest.approx(0.5 * 3**0.5 * 1e3, rel=0.2)


def test_small_heads_get_a_coarser_level() -> None:
    assert level_for(TOY, 640.0) == 256
    assert level_for(TOY, 40.0) == 64


@pytest.mark.parametrize(
    "changes", [{"rounds": 0}, {"threads": ()}, {"threads": (0,)}, {"blocks": ("X",)}]
)
def test_a_bench_that_makes_no_sense_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(OptionError, match=next(iter(changes)).removesuffix("s")):
        DecodeBenchConfig(**changes)
