"""The benches that draw count and compare what they say: a head, a scene, a driven avatar."""

from functools import partial
from typing import Any

import numpy as np
import pytest

from helpers.paths import ROOT
from helpers.toy import grid_faces, make_toy_avatar, with_toy_levels
from pica_client.avatars.library import AvatarLibrary
from pica_client.bench.decode import DecodeBenchConfig, run_decode_bench
from pica_client.bench.drive import DriveBenchConfig, run_drive_bench, same_vertices
from pica_client.bench.scene import (
    BUDGETS_MS,
    DISTANCES_CM,
    SceneBenchConfig,
    run_scene_bench,
    summarise,
)
from pica_core.avatar.spec import AvatarSpec
from pica_core.capture.person import subject

pytestmark = pytest.mark.render

TOY = with_toy_levels(
    make_toy_avatar(spec=AvatarSpec(uv_encoding_size=16, axis_encoding_size=20), grid=8)
)


def rows_of(result: dict[str, Any], **wanted: Any) -> list[dict[str, Any]]:
    return [row for row in result["rows"] if all(row[key] == wanted[key] for key in wanted)]


def test_every_level_is_decoded_whole_and_in_part_and_drawn_beside_the_baseline() -> None:
    result = run_decode_bench(DecodeBenchConfig(rounds=3, image_size=96), TOY)
    decodes = [(row["level"], row["parts"]) for row in rows_of(result, work="decode")]
    wanted = [(level, parts) for level in TOY.levels for parts in ("both", "expression")]
    assert decodes == [*wanted, (None, None)]
    near, far = (rows_of(result, work="draw", distance_cm=cm) for cm in (18.0, 120.0))
    for drawn in (near, far):
        assert [row["level"] for row in drawn] == [*TOY.levels, None]
    for one, other in zip(near, far, strict=True):
        assert 0 < other["pixels"] < 0.4 * one["pixels"]
    for row in rows_of(result, work="draw", model="pica"):
        assert row["triangles"] == len(TOY.level_faces(row["level"]))
    assert all(0 < row["ms"] <= row["p95"] for row in result["rows"])
    assert set(result["baseline_ratio"]) == {"64", "128", "256"}
    assert all(value > 0 for value in result["baseline_ratio"].values())


# A scene


def test_every_scene_is_measured_without_and_with_the_scheduler() -> None:
    config = SceneBenchConfig(heads=2, width=160, height=90, rounds=2)
    rows = run_scene_bench(config, [with_toy_levels(make_toy_avatar())])["rows"]
    names = ("avatars", "distance_cm", "scheduler", "budget_ms")
    scenes = [(1, 18.0), *((count, cm) for cm in DISTANCES_CM for count in (1, 2))]
    assert [tuple(row[name] for name in names) for row in rows] == [
        *((*scene, scheduler, None) for scene in scenes for scheduler in (False, True)),
        *((2, cm, True, budget) for cm in DISTANCES_CM for budget in BUDGETS_MS),
    ]
    assert all(row["pixels"] > 0 for row in rows)
    for row in rows:  # without it everybody is decoded in every frame, and nothing is lost
        assert row["scheduler"] or (row["decodes"], row["error"]) == (row["avatars"], 0)


def test_the_summary_compares_with_one_head_that_fills_the_screen() -> None:
    def row(avatars: int, distance_cm: float, total_ms: float, error: float) -> dict[str, Any]:
        names = ("avatars", "distance_cm", "total_ms", "error", "budget_ms")
        return dict(zip(names, (avatars, distance_cm, total_ms, error, None), strict=True))

    rows = [row(1, 18.0, 20.0, 0.0), row(5, 65.0, 60.0, 0.0), row(5, 65.0, 24.0, 0.5)]
    (scene,) = summarise(rows)["scenes"]
    assert scene["scheduled_over_full_screen"] == 1.2
    assert scene["unscheduled_over_full_screen"] == 3.0
    assert scene["error"] == 0.5


# An avatar under live drive, beside the head itself


def test_an_avatar_resembles_its_head_most_at_the_full_level(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    quick = partial(subject.PersonSubject, bake_size=512, self_shadow=False)
    monkeypatch.setattr(subject, "PersonSubject", quick)
    library = AvatarLibrary()
    amara = library.load(library.find("amara"))
    library.close()
    config = DriveBenchConfig(
        sources=("performance:talk",),
        seconds=3.0,
        moments=2,
        image_size=128,
        person=ROOT / "scripts" / "people" / "amara.json",
    )
    rows = run_drive_bench(config, [amara])["rows"]
    mse = {row["level"]: row["mse"] for row in rows}
    assert len(mse) == len(rows) == 3
    assert mse[256] < mse[64]
    assert all(8_000 < row["wire_bps"] < 25_000 for row in rows)
    assert all(row["lip_mm"] < 1 and row["lid_mm"] < 1 for row in rows)


def test_vertices_of_an_avatar_are_found_in_any_order_and_no_others() -> None:
    mesh = grid_faces(9, 9)
    order = np.random.default_rng(3).permutation(81)
    faces = np.argsort(order)[mesh]
    assert np.array_equal(same_vertices(faces, mesh), order)
    assert np.array_equal(same_vertices(mesh, mesh), np.arange(81))
    faces[7] = faces[7, ::-1]
    assert same_vertices(faces, mesh) is None
    assert same_vertices(mesh[1:], mesh) is None
    assert same_vertices(mesh[:-1], mesh) is None
    more = np.concatenate([mesh, mesh[:1] + 81])
    assert same_vertices(more, mesh).tolist()[-1] == -1
