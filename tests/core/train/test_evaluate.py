"""Figures of merit on cases that a person can follow, and the paper's tables from small runs."""

import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from helpers.small_capture import NAME
from pica_core.avatar.spec import BLOCKS, VARIANTS
from pica_core.capture.dataset.dataset import Capture
from pica_core.errors import CaptureError, TrainingError
from pica_core.train.cli.eval import EvalOptions, error_table, eval_runs
from pica_core.train.cli.train import ClaimOptions, TrainOptions, bench_claim, views_below
from pica_core.train.config import PRESETS
from pica_core.train.data import TrainingData
from pica_core.train.evaluate import mse, ssim
from pica_core.train.train import open_trainer, read_checkpoint

pytestmark = [pytest.mark.train, pytest.mark.usefixtures("one_thread")]

VARIANTS_HERE = ("full", "baseline", "coarse")


@pytest.fixture(scope="module")
def runs(data: TrainingData, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Runs that were stopped before their first step: means of the capture, no motion."""
    folders: dict[str, Path] = {}
    for variant in VARIANTS_HERE:
        folder = folders[variant] = tmp_path_factory.mktemp(variant)
        config = replace(PRESETS["tiny"], variant=variant, texture_size=64)
        with open_trainer(data, config, folder) as trainer:
            trainer.save()
    return folders


def test_the_error_is_the_mean_square_over_pixels_and_channels() -> None:
    picture = np.array([[1, 2, 3], [0, 0, 4]], np.uint8)
    assert mse(picture, np.zeros((2, 3), np.uint8)) == 5.0


def test_ssim_of_covered_pixels_agrees_with_another_implementation() -> None:
    a, b = np.random.default_rng(0).uniform(0, 255, (2, 14, 13, 3))
    covered = np.zeros((14, 13), bool)
    covered[6:8, 5:8] = True

    _, wanted = structural_similarity(
        a, b, channel_axis=2, gaussian_weights=True, use_sample_covariance=False,
        data_range=255, full=True,
    )  # fmt: skip

    assert ssim(a, b, covered) == pytest.approx(wanted[covered].mean(), rel=1e-9)


@pytest.fixture(scope="module")
def table(runs: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    out = tmp_path_factory.mktemp("tables")
    options = EvalOptions(runs=tuple(runs.values()), out=out, frames=4)
    return {"result": eval_runs(options), "out": out}


def test_rows_of_a_table_have_what_the_charts_need(
    table: dict[str, Any], data: TrainingData
) -> None:
    rows = table["result"]["rows"]

    wanted = "identity variant block view mse mse_low mse_high ssim parameters macs steps seed"
    assert len(rows) == len(VARIANTS_HERE) * len(data.images.evaluation_views)
    for row in rows:
        assert set(wanted.split()) <= set(row)
        assert row["identity"] == NAME
        assert row["mse_low"] <= row["mse"] <= row["mse_high"]
        assert 0 < row["ssim"] < 1
    parameters = {row["variant"]: row["parameters"] for row in rows}
    assert parameters["baseline"] > 4 * parameters["full"]
    assert parameters["coarse"] == parameters["full"]
    blocks = {row["variant"]: row["block"] for row in rows}
    assert blocks["baseline"] is None
    assert blocks["full"] in BLOCKS
    assert f"| {NAME} | coarse |" in (table["out"] / "table.md").read_text()


ROW = {"identity": "S1", "view": "front", "mse_low": 0.0, "mse_high": 9.0, "variant": "full"}


def test_seeds_are_shown_as_their_mean_with_the_lowest_and_the_highest() -> None:
    rows = [{**ROW, "seed": seed, "mse": mse} for seed, mse in enumerate((3.0, 2.0, 4.0))]
    rows.append({**ROW, "variant": "baseline", "seed": 0, "mse": 2.5})

    lines = error_table(rows).splitlines()

    assert lines[2:] == [
        "| S1 | full | 3.00 (2.00 to 4.00) |",
        "| S1 | baseline | **2.50** (0.00 to 9.00) |",
    ]


def test_runs_that_a_table_would_show_as_one_are_refused(
    runs: dict[str, Path], captured: Path, tmp_path: Path
) -> None:
    again, other, elsewhere = (tmp_path / name for name in ("again", "other", "elsewhere"))
    shutil.copytree(runs["full"], again)
    shutil.copytree(captured, elsewhere)
    config = read_checkpoint(runs["coarse"])["config"]
    with open_trainer(TrainingData(Capture.open(elsewhere)), config, other) as trainer:
        trainer.save()

    with pytest.raises(TrainingError, match=f"{runs['full']} and {again} are both full"):
        eval_runs(EvalOptions(runs=(runs["full"], runs["coarse"], again)))
    with pytest.raises(TrainingError, match="are both full"):
        eval_runs(EvalOptions(runs=(runs["full"], runs["full"])))
    with pytest.raises(TrainingError, match=f"{captured} and {elsewhere} are two captures"):
        eval_runs(EvalOptions(runs=(runs["full"], other)))


def test_the_command_knows_every_variant_and_preset() -> None:
    hints = get_type_hints(TrainOptions)

    (names, _) = get_args(hints["variant"])  # or none
    assert set(get_args(names)) == set(VARIANTS)
    assert set(get_args(hints["preset"])) == set(PRESETS)


STEPS = dict.fromkeys(("geometry_steps", "joint_steps", "driver_steps"), 3)


def test_rows_name_errors_of_each_model_and_view_and_finished_runs_stay(
    captured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PRESETS, "tiny", replace(PRESETS["tiny"], **STEPS))

    def options(**changes: Any) -> ClaimOptions:
        given = {"variants": ("linear", "baseline"), "preset": "tiny", "seeds": 1, **changes}
        return ClaimOptions(**{"captures": (captured,), "out": tmp_path, "eval_frames": 2, **given})

    result = bench_claim(options())

    rows = result["rows"]
    assert [row["variant"] for row in rows] == ["linear"] * 2 + ["baseline"] * 2
    assert {row["view"] for row in rows} == {"front", "left"}
    for row in rows:
        assert row["identity"] == "someone"
        numbers = [row[name] for name in ("mse", "live_mse", "vertex_error_mm", "seconds")]
        assert all(math.isfinite(value) and value > 0 for value in numbers)
    by_variant = {row["variant"]: row for row in rows}
    assert by_variant["linear"]["vertex_error_mm"] < by_variant["baseline"]["vertex_error_mm"]
    assert result["summary"] == {"views_below": sum(views_below(rows)), "views": 2}

    assert bench_claim(options()) == result
    with pytest.raises(TrainingError, match="made with other options"):
        bench_claim(options(preset="small"))


def test_a_view_counts_where_the_default_lies_below() -> None:
    def row(variant: str, view: str, mse: float) -> dict[str, Any]:
        return {"variant": variant, "identity": "x", "seed": 0, "view": view, "mse": mse}

    rows = [row("linear", "front", 2.0), row("baseline", "front", 3.0)]
    rows += [row("linear", "left", 3.0), row("baseline", "left", 3.0), row("linear", "up", 1.0)]
    assert views_below(rows) == [True, False]


def test_bad_input_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="two are called 'x'"):
        ClaimOptions(captures=(tmp_path / "x", tmp_path / "y" / "x"))
    with pytest.raises(TrainingError, match="variants is empty"):
        ClaimOptions(captures=(tmp_path,), variants=())
    with pytest.raises(CaptureError):
        bench_claim(ClaimOptions(captures=(tmp_path / "nobody",), out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()
