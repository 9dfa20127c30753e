"""The ratios that `pica bench scene` is run for. Pure."""

from collections.abc import Sequence
from typing import Any

FULL_SCREEN_CM = 18.0
"""Where one head fills the screen; the paper's nearest distance."""
AWAY = "away"
"""The view of a camera that looks the other way."""


def summarise(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The ratios that the rows are measured for; ``docs/benches.md`` says which."""
    most = max(row["avatars"] for row in rows)
    full_ms = next(
        row["total_ms"]
        for row in rows
        if row["distance_cm"] == FULL_SCREEN_CM and not row["scheduler"]
    )
    largest = [
        row
        for row in rows
        if row["avatars"] == most and row["view"] != AWAY and row["distance_cm"] != FULL_SCREEN_CM
    ]
    scenes = []
    budgets = []
    for distance in sorted({row["distance_cm"] for row in largest}):
        here = [row for row in largest if row["distance_cm"] == distance]
        plain = next(row for row in here if not row["scheduler"])
        free = next(row for row in here if row["scheduler"] and row["budget_ms"] is None)
        scenes.append(
            {
                "distance_cm": distance,
                "scheduled_over_full_screen": round(free["total_ms"] / full_ms, 3),
                "unscheduled_over_full_screen": round(plain["total_ms"] / full_ms, 3),
                "unscheduled_over_scheduled": round(plain["total_ms"] / free["total_ms"], 3),
                "error": free["error"],
            }
        )
        budgets += [
            {
                "distance_cm": distance,
                "budget_over_free": round(row["budget_ms"] / free["total_ms"], 3),
                "floor_over_free": round(row["floor_ms"] / free["total_ms"], 3),
                "spent_over_free": round(row["total_ms"] / free["total_ms"], 3),
                "error": row["error"],
                "error_rise": round(row["error"] - free["error"], 3),
                "limited": row["limited"],
                "levels": row["levels"],
                "meshes": row["meshes"],
            }
            for row in here
            if row["budget_ms"] is not None
        ]
    summary: dict[str, Any] = {"full_screen_ms": full_ms, "scenes": scenes, "budgets": budgets}
    for away in (row for row in rows if row["view"] == AWAY):
        seen = next(
            row
            for row in largest
            if row["distance_cm"] == away["distance_cm"] and not row["scheduler"]
        )
        summary["away"] = {
            "decodes": away["decodes"],
            "payload_over_seen": round(away["payload_bps"] / seen["payload_bps"], 4),
        }
    summary["plan_ms"] = max(row["plan_ms"] for row in rows)
    return summary
