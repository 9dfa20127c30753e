"""`pica bench render` and `pica avatar measure`: that they measure, not how fast a machine is."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.bench import level_measure
from pica_client.bench.level_measure import camera_for, measure_levels, with_errors
from pica_client.bench.render import RenderBenchConfig, fit_line, run_render_bench, summarise
from pica_client.errors import OptionError
from pica_client.render.scene import clip_from_head
from pica_client.schedule.visibility import PlacedHead, look
from pica_command.main import main
from pica_core.avatar.file import Avatar, load_avatar, save_avatar

pytestmark = pytest.mark.render

TOY = with_toy_levels(make_toy_avatar(), errors=False)


def test_a_line_through_times_that_lie_on_one_is_found() -> None:
    rows = [{"pixels": n, "draw_ms": 2.5 + 40e-6 * n} for n in (1000, 50_000, 200_000, 900_000)]
    line = fit_line(rows)
    assert line["intercept_ms"] == pytest.approx(2.5)
    assert line["ns_per_pixel"] == pytest.approx(40)
    assert line["r2"] == pytest.approx(1)
    assert line["worst_ms"] == pytest.approx(0, abs=1e-6)


def row(model: str, level: int, draw_ms: float, vertex_ms: float, **more: object) -> dict:
    weights = "turns" if model == "pica" else None
    common = {"distance_cm": 65.0, "mesh": level, "weights": weights}
    times = {f"draw_{clock}ms": draw_ms for clock in ("", "cpu_")}
    times |= {f"vertex_{clock}ms": vertex_ms for clock in ("", "cpu_")}
    return {**common, **times, "model": model, "level": level, **more}


def test_the_summary_divides_by_the_baseline_and_by_the_full_mesh() -> None:
    rows = [
        row("pica", 64, 4.0, 1.0),
        row("pica", 256, 9.0, 4.0),
        row("pica", 256, 6.0, 1.0, mesh=64),
        row("pica", 256, 20.0, 4.0, weights="block"),
        row("baseline", 0, 3.0, 1.5),
    ]
    ratios = summarise(rows, [], "turns")["ratios"]
    names = ("level", "mesh", "draw_over_baseline", "vertex_over_full")
    assert [tuple(r[name] for name in names) for r in ratios] == [
        (64, 64, 1.333, 0.25),
        (256, 256, 3.0, 1.0),
        (256, 64, 2.0, 0.25),
    ]


def test_a_bench_of_a_toy_counts_what_it_draws() -> None:
    config = RenderBenchConfig(
        distances_cm=(65.0, 200.0), image_size=96, rounds=3, sweep_points=3, soak_frames=60
    )
    result = run_render_bench(config, TOY)
    rows = result["rows"]
    near = [r for r in rows if r["distance_cm"] == 65.0 and r["model"] == "pica"]
    ways = {(64, 64), (128, 128), (256, 64), (256, 128), (256, 256)}
    assert {(r["level"], r["mesh"]) for r in near} == ways
    assert {r["weights"] for r in near} == {"block", "constants", "turns"}
    for drawn in near:
        assert drawn["triangles"] == len(TOY.level_faces(drawn["mesh"]))
    assert all(r["draw_ms"] > 0 and r["draw_cpu_ms"] > 0 and r["pixels"] > 0 for r in rows)
    full = max(r["pixels"] for r in near)
    (baseline,) = (r for r in rows if r["distance_cm"] == 65.0 and r["model"] == "baseline")
    assert baseline["pixels"] == pytest.approx(full, rel=0.1)
    far = max(r["pixels"] for r in rows if r["distance_cm"] == 200.0)
    assert far < 0.4 * full
    lines = {(line["model"], line["level"], line["time"]) for line in result["lines"]}
    kinds = [*(("pica", level) for level in TOY.levels), ("baseline", 0)]
    assert lines == {(*kind, time) for kind in kinds for time in ("draw_ms", "draw_cpu_ms")}
    assert result["soak"]["frames"] == 60
    json.dumps(result)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rounds": 1}, "rounds is 1; 3 to 1000"),
        ({"image_size": 9}, "image_size is 9; 64 to 4096"),
        ({"distances_cm": (0.1,)}, "distances_cm are"),
    ],
)
def test_a_bench_that_makes_no_sense_is_refused(changes: dict, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        RenderBenchConfig(**changes)


@pytest.mark.parametrize("head_px", [20.0, 300.0])
@pytest.mark.parametrize(("yaw", "pitch"), level_measure.VIEWS)
def test_a_measured_head_is_as_high_as_it_should_be(
    head_px: float, yaw: float, pitch: float
) -> None:
    camera = camera_for(TOY, head_px, 400, yaw, pitch)
    head = PlacedHead(
        "p0",
        clip_from_head(camera, level_measure.HEAD),
        TOY.manifest.bounds_min_m,
        TOY.manifest.bounds_max_m,
    )
    sight = look([head], (400, 400))["p0"]
    assert sight.head_px == pytest.approx(head_px, rel=1e-4)
    assert sight.centre_px == pytest.approx((200, 200), abs=0.1 * head_px)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(level_measure, "HEAD_PX", (24.0, 48.0))
    monkeypatch.setattr(level_measure, "SENSITIVITY_HEAD_PX", 64.0)
    monkeypatch.setattr(level_measure, "TRUTH_PX", 96)
    monkeypatch.setattr(level_measure, "MOMENTS", level_measure.MOMENTS[:1])
    monkeypatch.setattr(level_measure, "VIEWS", level_measure.VIEWS[:2])


@pytest.mark.usefixtures("quick")
def test_a_table_tells_levels_and_meshes_apart_and_is_the_same_each_time() -> None:
    told: list[float] = []
    first, second = measure_levels(TOY, told.append), measure_levels(TOY)
    assert first.levels == TOY.levels
    assert first.mse.shape == (3, 2, 2)
    np.testing.assert_array_equal(first.mse, second.mse)
    # The middle level may beat the full one at heads this small: its maps alias less.
    assert (first.mse[2, 0] < first.mse[0, 0]).all()
    assert (first.mse[:-1, 1] != first.mse[:-1, 0]).all()
    np.testing.assert_array_equal(first.mse[-1, 0], first.mse[-1, 1])
    assert first.view_mse_per_rad2 > 0
    assert first.latent_mse_per_unit2 > 0
    assert told == sorted(told)
    assert told[-1] == 1


def test_a_table_stands_in_the_avatars_file(
    tmp_path: Path, quick: None, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "toy.pica", tmp_path / "measured.pica"
    save_avatar(path, TOY)
    assert main(["avatar", "measure", str(path), "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    before, after = load_avatar(path), load_avatar(out)
    assert before.level_errors is None
    assert after.level_errors is not None
    np.testing.assert_allclose(after.level_errors.mse[0, 1], told["rows"][1]["mse"], rtol=1e-6)
    for name, array in before.tensors.items():
        np.testing.assert_allclose(after.tensors[name], array, atol=1e-6, err_msg=name)


def test_a_table_replaces_the_one_before() -> None:
    measured: Avatar = with_toy_levels(make_toy_avatar())
    errors = measured.level_errors
    assert errors is not None
    doubled = type(errors)(
        levels=errors.levels,
        head_px=errors.head_px,
        mse=errors.mse * 2,
        view_mse_per_rad2=1.0,
        latent_mse_per_unit2=2.0,
    )
    found = with_errors(measured, doubled).level_errors
    assert found is not None
    np.testing.assert_array_equal(found.mse, errors.mse * 2)
    assert (found.view_mse_per_rad2, found.latent_mse_per_unit2) == (1.0, 2.0)
