"""Heads in front of the scheduler."""

from __future__ import annotations

import numpy as np

from helpers.toy import make_toy_avatar, with_toy_levels
from pica_client.decode.request import DecodeRequest
from pica_client.schedule.head import Choice, Head
from pica_client.schedule.scheduler import Plan, Scheduler
from pica_client.schedule.visibility import NOTHING, Sight
from pica_core.latent import LATENT_SHAPE

TOY = with_toy_levels(make_toy_avatar())
LEVELS = TOY.levels
TRIANGLES = (4_000, 16_000, 50_000)
FRAME_S = 1 / 30
NOW_S = 100.0
AMPLE_S = 10.0
LATENT = np.zeros(LATENT_SHAPE, np.float32)
AHEAD = np.array([0, 0, 1], np.float32)


def view(
    slot: str = "ada",
    head_px: float = 300.0,
    *,
    held_level: int | None = 256,
    age_s: float = FRAME_S,
    hidden_ratio: float = 0.0,
    num_views: int = 1,
    latent_change: float = 0.3,
    view_turn_rad: float = 0.01,
) -> Head:
    """A talking head of this height, decoded one frame ago."""
    head = Head(slot=slot, avatar=TOY)
    head.num_triangles = TRIANGLES
    head.sight = Sight(
        is_visible=True,
        visible_px=0.6 * num_views * head_px * head_px,
        head_px=head_px,
        hidden_ratio=hidden_ratio,
        num_views=num_views,
    )
    head.latent_change, head.view_turn_rad = latent_change, view_turn_rad
    if held_level is not None:
        head.asked = DecodeRequest(LATENT, AHEAD, 0, held_level)
        head.asked_s = head.latent_asked_s = NOW_S - age_s
    return head


def unseen(slot: str = "ada") -> Head:
    """The same behind the viewer."""
    head = view(slot)
    head.sight = NOTHING
    return head


def plan(*heads: Head, budget_s: float = AMPLE_S, scheduler: Scheduler | None = None) -> Plan:
    """A plan of a frame, by a scheduler that has planned no other."""
    return (scheduler or Scheduler()).plan(heads, budget_s, now=NOW_S)


def choose(head: Head, budget_s: float = AMPLE_S) -> Choice:
    """What a head alone gets."""
    return plan(head, budget_s=budget_s).choices[head.slot]


def detail(choice: Choice) -> tuple[float, int, int]:
    """How fine a head is drawn."""
    return choice.scale, choice.level, choice.mesh_level
