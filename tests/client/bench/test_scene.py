"""The scene bench counts and compares what it says."""

from typing import Any

import pytest

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.bench.scene import (
    BUDGETS_MS,
    DISTANCES_CM,
    SceneBenchConfig,
    run_scene_bench,
    summarise,
)

pytestmark = pytest.mark.render


@pytest.fixture(scope="module")
def rows() -> list[dict[str, Any]]:
    config = SceneBenchConfig(heads=2, width=160, height=90, rounds=2)
    found: list[dict[str, Any]] = run_scene_bench(config, [with_toy_levels(make_toy_avatar())])[
        "rows"
    ]
    return found


def test_without_the_scheduler_everybody_is_decoded_in_every_frame_and_nothing_is_lost(
    rows: list[dict[str, Any]],
) -> None:
    for row in (each for each in rows if not each["scheduler"]):
        assert row["decodes"] == row["avatars"]
        assert row["error"] == 0


def test_every_scene_is_measured_without_and_with_the_scheduler(rows: list[dict[str, Any]]) -> None:
    names = ("avatars", "distance_cm", "scheduler", "budget_ms")
    scenes = [(1, 18.0), *((count, cm) for cm in DISTANCES_CM for count in (1, 2))]
    assert [tuple(row[name] for name in names) for row in rows] == [
        *((*scene, scheduler, None) for scene in scenes for scheduler in (False, True)),
        *((2, cm, True, budget) for cm in DISTANCES_CM for budget in BUDGETS_MS),
    ]
    assert all(row["pixels"] > 0 for row in rows)


def test_the_summary_compares_with_one_head_that_fills_the_screen() -> None:
    def row(avatars: int, distance_cm: float, total_ms: float, error: float) -> dict[str, Any]:
        names = ("avatars", "distance_cm", "total_ms", "error", "budget_ms")
        return dict(zip(names, (avatars, distance_cm, total_ms, error, None), strict=True))

    rows = [row(1, 18.0, 20.0, 0.0), row(5, 65.0, 60.0, 0.0), row(5, 65.0, 24.0, 0.5)]
    (scene,) = summarise(rows)["scenes"]
    assert scene["scheduled_over_full_screen"] == 1.2
    assert scene["unscheduled_over_full_screen"] == 3.0
    assert scene["error"] == 0.5
