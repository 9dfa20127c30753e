"""The scene bench counts and compares what it says."""

from __future__ import annotations

from typing import Any

import pytest

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.bench.scene import SceneBenchConfig, run_scene_bench, summarise

pytestmark = pytest.mark.render


@pytest.fixture(scope="module")
def result() -> dict[str, Any]:
    config = SceneBenchConfig(
        avatars=(1, 3), distances_cm=(120.0,), width=160, height=90, rounds=2, budget_shares=(0.5,)
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


def test_every_scene_is_measured_with_and_without_the_scheduler_and_on_a_budget(
    result: dict[str, Any],
) -> None:
    seen = rows_of(result, budget_ms=None)
    assert [(row["avatars"], row["distance_cm"], row["scheduler"]) for row in seen] == [
        *((1, 18.0, scheduler) for scheduler in (False, True)),
        *((count, 120.0, scheduler) for count in (1, 3) for scheduler in (False, True)),
    ]
    (limited,) = [row for row in result["rows"] if row["budget_ms"] is not None]
    assert limited["avatars"] == 3
    assert limited["pixels"] == seen[-1]["pixels"] > 0


def test_the_summary_compares_with_one_head_that_fills_the_screen() -> None:
    def row(**given: Any) -> dict[str, Any]:
        return {"budget_ms": None, "error": 0.0, "floor_ms": 2.0, **given}

    rows = [
        row(avatars=1, distance_cm=18.0, scheduler=False, total_ms=20.0),
        row(avatars=5, distance_cm=65.0, scheduler=False, total_ms=60.0),
        row(avatars=5, distance_cm=65.0, scheduler=True, total_ms=24.0, error=0.5),
        row(avatars=5, distance_cm=65.0, scheduler=True, total_ms=12.5, budget_ms=12.0, error=2.0),
    ]
    summary = summarise(rows)
    (scene,), (budget,) = summary["scenes"], summary["budgets"]
    assert scene["scheduled_over_full_screen"] == 1.2
    assert scene["unscheduled_over_full_screen"] == 3.0
    assert budget["budget_over_free"] == 0.5
