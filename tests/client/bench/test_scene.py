"""The scene bench counts and compares what it says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.bench.scene import SceneBenchConfig, run_scene_bench
from pica_client.bench.scene_summary import summarise
from pica_client.errors import OptionError

pytestmark = pytest.mark.render


@pytest.fixture(scope="module")
def sheet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scene") / "scene.png"


@pytest.fixture(scope="module")
def result(sheet: Path) -> dict[str, Any]:
    config = SceneBenchConfig(
        avatars=(1, 3),
        distances_cm=(120.0,),
        width=160,
        height=90,
        rounds=2,
        budget_shares=(0.5,),
        sheet=sheet,
    )
    return run_scene_bench(config, [with_toy_levels(make_toy_avatar())])


def rows_of(result: dict[str, Any], **wanted: Any) -> list[dict[str, Any]]:
    return [row for row in result["rows"] if all(row[key] == wanted[key] for key in wanted)]


def test_without_the_scheduler_everybody_is_decoded_in_every_frame_and_nothing_is_lost(
    result: dict[str, Any],
) -> None:
    for row in rows_of(result, scheduler=False):
        assert row["decodes"] == row["avatars"]
        assert row["error"] == 0


def test_with_nobody_on_the_screen_nothing_is_decoded_drawn_or_sent(
    result: dict[str, Any],
) -> None:
    (row,) = rows_of(result, view="away")
    assert row["decodes"] == row["payload_bps"] == row["triangles"] == 0
    assert result["summary"]["away"] == {"decodes": 0, "payload_over_seen": 0}


def test_every_scene_is_measured_with_and_without_the_scheduler_and_on_a_budget(
    result: dict[str, Any],
) -> None:
    seen = rows_of(result, view="front", budget_ms=None)
    assert [(row["avatars"], row["distance_cm"], row["scheduler"]) for row in seen] == [
        *((1, 18.0, scheduler) for scheduler in (False, True)),
        *((count, 120.0, scheduler) for count in (1, 3) for scheduler in (False, True)),
    ]
    (limited,) = [row for row in result["rows"] if row["budget_ms"] is not None]
    assert limited["avatars"] == 3
    assert limited["pixels"] == seen[-1]["pixels"] > 0


def test_the_sheet_shows_each_treatment_of_the_largest_scene_above_its_difference(
    result: dict[str, Any], sheet: Path
) -> None:
    with Image.open(sheet) as picture:
        width, height = picture.size
    assert width == 160
    assert height // (2 * 90) == 3  # whole, scheduled, on a budget
    assert result["rows"]


def test_the_summary_compares_with_one_head_that_fills_the_screen() -> None:
    def row(**given: Any) -> dict[str, Any]:
        usual = {"view": "front", "budget_ms": None, "error": 0.0, "plan_ms": 0.1, "limited": 0.0}
        return {**usual, "levels": {}, "meshes": {}, "floor_ms": 2.0, **given}

    rows = [
        row(avatars=1, distance_cm=18.0, scheduler=False, total_ms=20.0),
        row(avatars=5, distance_cm=65.0, scheduler=False, total_ms=60.0, payload_bps=1000),
        row(avatars=5, distance_cm=65.0, scheduler=True, total_ms=24.0, error=0.5),
        row(avatars=5, distance_cm=65.0, scheduler=True, total_ms=12.5, budget_ms=12.0, error=2.0),
    ]
    summary = summarise(rows)
    (scene,), (budget,) = summary["scenes"], summary["budgets"]
    assert scene["scheduled_over_full_screen"] == 1.2
    assert scene["unscheduled_over_full_screen"] == 3.0
    assert scene["unscheduled_over_scheduled"] == 2.5
    assert budget["budget_over_free"] == 0.5
    assert budget["error_rise"] == 1.5


@pytest.mark.parametrize(
    "changes",
    [{"avatars": ()}, {"avatars": (17,)}, {"distances_cm": (0.5,)}, {"budget_shares": (1.5,)}],
)
def test_settings_out_of_range_are_refused_by_name(changes: dict[str, Any]) -> None:
    with pytest.raises(OptionError, match=next(iter(changes))):
        SceneBenchConfig(**changes)


def test_expected_costs_are_the_same_in_every_run() -> None:
    config = SceneBenchConfig(
        avatars=(2,),
        distances_cm=(120.0,),
        width=160,
        height=90,
        rounds=2,
        budget_shares=(0.5,),
        expected_costs=True,
    )
    runs = [run_scene_bench(config, [with_toy_levels(make_toy_avatar())]) for _ in range(2)]
    totals = [[row["total_ms"] for row in run["rows"]] for run in runs]
    assert totals[0] == totals[1]
    whole, free = (rows_of(runs[0], avatars=2, scheduler=used)[0] for used in (False, True))
    assert whole["total_ms"] > free["total_ms"] > 0
