"""``scripts/bench_models.py``: trained models, the errors that eval measured, and both joined."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.script import load_script
from helpers.toy import grid_faces, head_surface, make_toy_avatar
from pica_client.errors import OptionError
from pica_core.avatar.baseline import BaselineAvatar, BaselineSpec, baseline_channels, save_baseline
from pica_core.avatar.file import save_avatar
from pica_core.avatar.spec import AvatarSpec
from pica_core.errors import AvatarFileError

pytestmark = pytest.mark.render

SCRIPT = load_script("bench_models")
ModelKey, open_models, held_out_errors = (
    SCRIPT.ModelKey,
    SCRIPT.open_models,
    SCRIPT.held_out_errors,
)

SMALL = {"uv_encoding_size": 16, "axis_encoding_size": 20}
VIEWS = ("front", "left")


def save_toy(path: Path, *, seed: int = 7, **spec: Any) -> None:
    save_avatar(path, make_toy_avatar(seed=seed, spec=AvatarSpec(**SMALL, **spec), grid=12))


def save_toy_baseline(path: Path, *, has_encoder: bool = True, grid: int = 12) -> None:
    """A smooth head whose texture is 32 texels wide."""
    rng = np.random.default_rng(3)
    spec = BaselineSpec(num_vertices=grid * grid, channels=baseline_channels(32))
    tensors = {
        name: (0.01 * rng.standard_normal(shape)).astype(np.float32)
        for name, shape in spec.tensor_shapes().items()
    }
    u, v = np.meshgrid(*[np.linspace(0.01, 0.99, grid, dtype=np.float32)] * 2)
    tensors["mesh.weight"] *= 0.01
    tensors["mesh.bias"] = head_surface(u, v).reshape(-1)
    if has_encoder:
        avatar = make_toy_avatar(spec=AvatarSpec(**SMALL), grid=8)
        names = [name for name in avatar.tensors if name.startswith("encoder.")]
        tensors |= {name: avatar.tensors[name] for name in names}
    baseline = BaselineAvatar(
        spec=spec,
        tensors=tensors,
        vertex_uv=np.stack([u, v], axis=-1).reshape(-1, 2),
        faces=grid_faces(grid, grid),
        bounds_min_m=(-0.15, -0.2, -0.15),
        bounds_max_m=(0.15, 0.2, 0.2),
    )
    save_baseline(path, baseline)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A person's full model with two blocks, one without coordinates, and a baseline."""
    path = tmp_path_factory.mktemp("models")
    save_toy(path / "full-C.pica", block="C")
    save_toy(path / "full-B.pica", block="B")
    save_toy(path / "no_uv.pica", encoding="none")
    save_toy_baseline(path / "baseline.pica")
    return path


@pytest.fixture(scope="module")
def models(folder: Path) -> list[Any]:
    return open_models([str(folder)])


def eval_row(key: Any, view: str = "front", **changes: Any) -> dict[str, Any]:
    row = {**key._asdict(), "view": view, "mse": 20.0, "mse_low": 18.0, "mse_high": 23.0}
    row |= {"psnr_db": 35.0, "ssim": 0.9, "temporal_mse": None, "frames": 25}
    return row | {"parameters": 10, "macs": 1, "steps": 100, "seed": 0} | changes


def rows_of(models: Iterable[Any], **changes: Any) -> list[dict[str, Any]]:
    return [
        eval_row(model.key, view, parameters=model.cost.parameters, **changes)
        for model in models
        for view in VIEWS
    ]


def test_files_are_told_apart_by_what_they_hold(models: list[Any]) -> None:
    assert [tuple(model.key)[1:] for model in models] == [
        ("full", "B"),
        ("full", "C"),
        ("no_uv", "C"),
        ("baseline", None),
    ]
    assert {model.key.identity for model in models} == {"toy-7"}
    assert all(model.file_bytes > 0 for model in models)


def test_every_model_has_costs_at_every_distance_beside_its_error(models: list[Any]) -> None:
    errors = SCRIPT.join_errors(models, held_out_errors(rows_of(models)))
    config = SCRIPT.ModelsBenchConfig(distances_cm=(40.0, 90.0), image_size=64, frames=3)
    result = SCRIPT.run_models_bench(config, models, errors)

    rows = result["rows"]
    keys = [(row["variant"], row["block"], row["distance_cm"]) for row in rows]
    assert keys == [(*model.key[1:], cm) for model in models for cm in (40.0, 90.0)]
    for row in rows:
        for part in ("decode", "upload", "draw", "total"):
            assert 0 < row[f"{part}_ms_low"] <= row[f"{part}_ms"] <= row[f"{part}_ms_high"]
        assert row["mse"] == 20.0
    for near, far in zip(rows[::2], rows[1::2], strict=True):
        assert near["pixels"] > far["pixels"] > 100
    assert any(row["is_best"] for row in rows)


def test_a_model_is_described_by_what_it_computes(models: list[Any]) -> None:
    errors = SCRIPT.join_errors(models, held_out_errors(rows_of(models)))
    config = SCRIPT.ModelsBenchConfig(distances_cm=(65.0,), image_size=64, frames=3)
    found = SCRIPT.run_models_bench(config, models, errors)["models"]

    b, c, no_uv, baseline = found
    assert b["macs"] > 3 * c["macs"]
    assert c["macs_per_pixel"] == 308
    assert no_uv["macs_per_pixel"] == 244
    assert baseline["macs_per_pixel"] == 0
    assert {model["triangles"] for model in found} == {2 * 11 * 11}
    assert {(model["mse_low"], model["views"], model["steps"]) for model in found} == {
        (18.0, 2, 100)
    }


def test_an_error_is_the_mean_over_views() -> None:
    key = ModelKey("S1", "full", "C")
    first = eval_row(key, "front", mse=10.0, mse_low=8.0, mse_high=11.0)
    second = eval_row(key, "left", mse=20.0, mse_low=19.0, mse_high=24.0)

    error = held_out_errors([first, second])[key]

    means = [error[name] for name in ("mse_low", "mse", "mse_high", "views")]
    assert means == [13.5, 15.0, 17.5, 2]


def test_of_two_rows_about_the_same_the_later_counts() -> None:
    key = ModelKey("S1", "full", "C")
    assert held_out_errors([eval_row(key, mse=10.0), eval_row(key, mse=12.0)])[key]["mse"] == 12.0


def test_a_model_that_was_not_evaluated_is_named(models: list[Any]) -> None:
    rows = held_out_errors(rows_of(models[1:]))
    with pytest.raises(OptionError, match="no error of toy-7 full with block B; there are toy-7 b"):
        SCRIPT.join_errors(models, rows)


def test_rows_of_two_seeds_are_not_mixed() -> None:
    key = ModelKey("S1", "baseline", None)
    with pytest.raises(OptionError, match="S1 baseline was trained with several seeds"):
        held_out_errors([eval_row(key), eval_row(key, seed=1)])


def test_a_row_that_lacks_a_field_names_it() -> None:
    row = eval_row(ModelKey("S1", "full", "C"))
    del row["block"]
    with pytest.raises(OptionError, match="'block' is missing"):
        held_out_errors([row])


def test_rows_of_a_model_of_another_size_are_refused(models: list[Any]) -> None:
    rows = held_out_errors([eval_row(model.key) for model in models])
    with pytest.raises(OptionError, match="has 10 parameters, its file"):
        SCRIPT.join_errors(models, rows)


def test_models_that_were_measured_otherwise_are_not_compared(models: list[Any]) -> None:
    rows = rows_of(models[:1]) + rows_of(models[1:], frames=12)
    with pytest.raises(OptionError, match="in 2 views of 12 frames, others of toy-7 otherwise"):
        SCRIPT.join_errors(models, held_out_errors(rows))


def test_rows_are_read_as_eval_writes_prints_and_as_they_are_recorded(tmp_path: Path) -> None:
    key = ModelKey("S1", "full", "C")
    result = {"table": 1, "rows": [eval_row(key)]}
    texts = {
        "written": json.dumps(result, indent=1),
        "printed": f"# Table 1\n\n| identity | model |\n{json.dumps(result)}\n",
        "recorded": "\n".join(json.dumps({"commit": "1", "result": result}) for _ in range(2)),
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        assert held_out_errors(SCRIPT.read_rows(tmp_path / name))[key]["mse"] == 20.0


def test_a_baseline_is_of_the_one_person_beside_it_or_of_whom_is_written(
    folder: Path, tmp_path: Path
) -> None:
    baseline = str(folder / "baseline.pica")
    save_toy(tmp_path / "other.pica", seed=9)
    two = [str(folder / "full-C.pica"), str(tmp_path / "other.pica")]

    with pytest.raises(OptionError, match=r"baseline\.pica: .*write IDENTITY="):
        open_models([*two, baseline])
    models = open_models([*two, f"toy-9={baseline}"])

    assert [(model.key.identity, model.key.variant) for model in models] == [
        ("toy-7", "full"),
        ("toy-9", "full"),
        ("toy-9", "baseline"),
    ]


def test_an_avatar_knows_better_whom_it_shows(folder: Path) -> None:
    with pytest.raises(OptionError, match="shows toy-7, not Sam"):
        open_models([f"Sam={folder / 'full-C.pica'}"])


def test_files_that_make_no_comparison_are_refused(folder: Path, tmp_path: Path) -> None:
    file = str(folder / "full-C.pica")
    with pytest.raises(OptionError, match="toy-7 full with block C is there twice"):
        open_models([file, file])
    with pytest.raises(OptionError, match=r"no \.pica files in this folder"):
        open_models([str(tmp_path)])
    with pytest.raises(OptionError, match="files is empty"):
        open_models([])
    (tmp_path / "bad.pica").write_bytes(b"no such thing")
    with pytest.raises(AvatarFileError, match=r"bad\.pica"):
        open_models([str(tmp_path / "bad.pica")])
    save_toy_baseline(tmp_path / "mute.pica", has_encoder=False)
    with pytest.raises(OptionError, match="no expression encoder"):
        open_models([f"S1={tmp_path / 'mute.pica'}"])
