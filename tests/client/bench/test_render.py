"""`pica bench render`: that it measures, not how fast a machine is."""

from __future__ import annotations

import json

import pytest

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.bench.render import RenderBenchConfig, fit_line, run_render_bench, summarise
from pica_client.errors import OptionError

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
    ratios = summarise(rows, "turns")
    names = ("level", "mesh", "draw_over_baseline", "vertex_over_full")
    assert [tuple(r[name] for name in names) for r in ratios] == [
        (64, 64, 1.333, 0.25),
        (256, 256, 3.0, 1.0),
        (256, 64, 2.0, 0.25),
    ]


def test_a_bench_of_a_toy_counts_what_it_draws() -> None:
    config = RenderBenchConfig(distances_cm=(65.0, 200.0), image_size=96, rounds=3, sweep_points=3)
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
