"""`pica bench claim`: captures in, errors of each model and view out."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from helpers.small_capture import render_capture
from pica_core.capture.stage.synth import RenderOptions
from pica_core.errors import CaptureError, CheckpointError, TrainingOptionError
from pica_core.train.cli.train import ClaimOptions, bench_claim, views_below
from pica_core.train.config import PRESETS

pytestmark = [pytest.mark.train, pytest.mark.usefixtures("one_thread")]

STEPS = dict.fromkeys(("geometry_steps", "joint_steps", "driver_steps"), 3)
STAGE = RenderOptions(
    frames=20,
    cameras=2,
    size="64x64",
    texture_size=64,
    tracked_vertices=400,
)


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("heads") / "someone"
    render_capture(STAGE, folder)
    return folder


def test_rows_name_errors_of_each_model_and_view_and_finished_runs_stay(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PRESETS, "tiny", replace(PRESETS["tiny"], **STEPS))

    def options(**changes: Any) -> ClaimOptions:
        given = {"variants": ("linear", "baseline"), "preset": "tiny", "seeds": 1, **changes}
        return ClaimOptions(**{"captures": (capture,), "out": tmp_path, "eval_frames": 2, **given})

    result = bench_claim(options())

    rows = result["rows"]
    assert [row["variant"] for row in rows] == ["linear"] * 2 + ["baseline"] * 2
    assert {row["view"] for row in rows} == {"front", "left"}
    for row in rows:
        assert row["identity"] == "someone"
        numbers = [row[name] for name in ("mse", "live_mse", "vertex_mm", "lid_mm", "seconds")]
        assert all(math.isfinite(value) and value > 0 for value in numbers)
    by_variant = {row["variant"]: row for row in rows}
    assert by_variant["linear"]["vertex_mm"] < by_variant["baseline"]["vertex_mm"]
    assert result["summary"] == {"views_below": sum(views_below(rows)), "views": 2}

    assert bench_claim(options()) == result
    with pytest.raises(CheckpointError, match="made with other options"):
        bench_claim(options(preset="small"))


def test_a_view_counts_where_the_default_lies_below() -> None:
    def row(variant: str, view: str, mse: float) -> dict[str, Any]:
        return {"variant": variant, "identity": "x", "seed": 0, "view": view, "mse": mse}

    rows = [row("linear", "front", 2.0), row("baseline", "front", 3.0)]
    rows += [row("linear", "left", 3.0), row("baseline", "left", 3.0), row("linear", "up", 1.0)]
    assert views_below(rows) == [True, False]


def test_bad_input_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(TrainingOptionError, match="two are called 'x'"):
        ClaimOptions(captures=(tmp_path / "x", tmp_path / "y" / "x"))
    with pytest.raises(TrainingOptionError, match="variants is empty"):
        ClaimOptions(captures=(tmp_path,), variants=())
    with pytest.raises(CaptureError):
        bench_claim(ClaimOptions(captures=(tmp_path / "nobody",), out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()
