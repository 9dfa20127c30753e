"""Heads in front of the scheduler."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pica_client.schedule.error_model import ErrorModel
from pica_client.schedule.scheduler import Choice, HeadView, Plan, Scheduler
from pica_core.avatar.levels import default_errors

LEVELS = (64, 128, 256)
ERRORS = ErrorModel(default_errors(LEVELS))
TRIANGLES = (4_000, 16_000, 50_000)
FRAME_S = 1 / 30
AMPLE_S = 10.0
RANK = {"none": 0, "expression": 1, "both": 2}


def view(slot: str = "ada", head_px: float = 300.0, **changes: object) -> HeadView:
    """A talking head of this height, decoded one frame ago."""
    given: dict[str, object] = {
        "slot": slot,
        "errors": ERRORS,
        "num_triangles": TRIANGLES,
        "is_visible": True,
        "visible_px": 0.6 * head_px * head_px,
        "head_px": head_px,
        "distance_m": 300 / max(head_px, 1e-3),
        "held_level": 256,
        "latent_change": 0.3,
        "view_turn_rad": 0.01,
        "age_s": FRAME_S,
    }
    return HeadView(**(given | changes))  # type: ignore[arg-type]


def unseen(slot: str = "ada") -> HeadView:
    return view(slot, is_visible=False, visible_px=0.0, head_px=0.0)


def plan(*heads: HeadView, budget_s: float = AMPLE_S, scheduler: Scheduler | None = None) -> Plan:
    return (scheduler or Scheduler()).plan(heads, budget_s, now=100.0)


def choose(head: HeadView, budget_s: float = AMPLE_S) -> Choice:
    return plan(head, budget_s=budget_s).choices[head.slot]


def gentle() -> ErrorModel:
    """Errors that vanish for small heads, as measured ones do."""
    table = default_errors(LEVELS)
    share = np.clip((table.head_px - 16) / 100, 0, 1)
    mse = (5 + (table.mse - 5) * share).astype(np.float32)
    return ErrorModel(replace(table, mse=mse))


def amount(choice: Choice) -> tuple[int, int, int]:
    return (choice.level, RANK[choice.decode], choice.mesh_level)
