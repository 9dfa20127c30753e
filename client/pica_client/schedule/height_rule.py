"""A simple rule for what every avatar gets: level by height on the screen, decode by age. Pure.

    rule = HeightRule()
    plan = rule.plan(views, budget_s=0.008, now=now)       # as `Scheduler.plan`

A head that is taller than a threshold gets the level behind it, and taller heads are decoded more
often. When the frame is expected to cost more than its budget, every head counts as so many times
smaller, until it fits. It knows nothing of errors: `pica bench scene` draws it beside the
scheduler, to show what that one's tables and knapsack are worth.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from pica_client.schedule.cost_model import CostModel
from pica_client.schedule.lod_knapsack import Decode
from pica_client.schedule.scheduler import Choice, HeadView, Plan
from pica_protocol.limits import MAX_LAYER

FACE_S = 1 / 30
"""Between two faces of a stream."""
RAISE_RATIO = 0.95
"""Detail comes back when it would leave so much of the budget unspent."""
STEP = 1.1
"""Ratio of neighbouring sizes that are tried."""
MAX_SHRINK = 100.0
"""Smaller than by this factor no head counts."""
LOWER_RATIO = 0.85
"""A level is left when the head is this much lower than what it takes to get it."""
LAYER_PX = (12.0, 32.0)
HOLD_S = 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class HeightRuleOptions:
    """Heights at which a head gets more."""

    full_px: float = 80.0
    """From here on a head gets the full maps, below the coarsest (tuned, as all here: Sam at 50
    and 130 cm)."""
    mesh_px: tuple[float, ...] = (250.0, 500.0)
    """Where full maps get the second and third mesh of three."""
    refresh_px: float = 20.0
    """From here on every face is decoded; of heads half as high every second one."""
    least_change: float = 0.05
    """Root mean square over the latent; what changed less is decoded by its age alone."""
    max_age_s: float = 0.25
    """Maps of a moving face are not kept longer."""


class HeightRule:
    """Plans frame after frame by height and age alone; see the module for how."""

    def __init__(
        self, options: HeightRuleOptions | None = None, costs: CostModel | None = None
    ) -> None:
        self.options = options or HeightRuleOptions()
        self.costs = costs or CostModel()
        self._shrink = 1.0
        self._seen_s: dict[str, float] = {}
        self._now = -math.inf

    def plan(self, heads: Sequence[HeadView], budget_s: float, now: float) -> Plan:
        """Say what everybody gets in the frame that begins now; see `Scheduler.plan`."""
        frame_s = min(now - self._now, FACE_S)
        self._now = now
        self._seen_s = {
            view.slot: now if view.is_visible else self._seen_s.get(view.slot, now)
            for view in heads
        }
        seen = [view for view in heads if view.is_visible]
        while (
            self._shrink > 1
            and self._mean_s(seen, self._shrink / STEP, frame_s) < RAISE_RATIO * budget_s
        ):
            self._shrink /= STEP
        while self._shrink < MAX_SHRINK and self._mean_s(seen, self._shrink, frame_s) > budget_s:
            self._shrink *= STEP
        choices = {view.slot: self._unseen(view, now) for view in heads if not view.is_visible}
        spent_s = self._draw_s(seen, self._shrink)
        has_decoded = False
        for view in sorted(seen, key=lambda view: (-view.age_s, -view.head_px, view.slot)):
            level, mesh = self._places(view, self._shrink)
            decode = self._due(view, level, self._shrink)
            decode_s = 0.0
            if decode != "none":
                decode_s = self.costs.decode_s(view.model, view.errors.levels[level], decode)
                is_overdue = view.age_s >= self.options.max_age_s
                # The oldest one is decoded in any case, so that not all are overdue at once.
                is_dispensable = view.has_maps and has_decoded and not is_overdue
                if spent_s + decode_s > budget_s and is_dispensable:
                    decode, decode_s = "none", 0.0
                has_decoded = has_decoded or decode != "none"
            if decode != "both" and view.held_level is not None:
                level = view.errors.levels.index(view.held_level)
                mesh = min(mesh, level) if level == len(view.errors.levels) - 1 else level
            spent_s += decode_s
            choices[view.slot] = Choice(
                level=view.errors.levels[level],
                decode=decode,
                mesh_level=view.errors.levels[mesh],
                wanted_layer=bisect_right(LAYER_PX, view.head_px),
                error=0.0,
                cost_s=decode_s + self._head_s(view, mesh),
                is_limited=self._shrink > 1,
            )
        floor_s = self._mean_s(seen, MAX_SHRINK, frame_s)
        return Plan(
            choices=choices,
            budget_s=budget_s,
            cost_s=spent_s,
            floor_s=floor_s,
            error=0.0,
            num_steps=len(seen),
        )

    def forget(self, slot: str) -> None:
        """Remember nothing of a slot."""
        self._seen_s.pop(slot, None)

    def _places(self, view: HeadView, shrink: float) -> tuple[int, int]:
        """Places of the level of the maps and of the mesh among the avatar's."""
        top = len(view.errors.levels) - 1
        height = view.head_px / shrink
        holds_full = view.held_level == view.errors.levels[top]
        if height < self.options.full_px * (LOWER_RATIO if holds_full else 1.0):
            return 0, 0
        coarser = len(self.options.mesh_px) - bisect_right(self.options.mesh_px, height)
        return top, max(top - coarser, 0)

    def _interval_s(self, view: HeadView, shrink: float) -> float:
        height = max(view.head_px / shrink, 1.0)
        return min(FACE_S * max(self.options.refresh_px / height, 1.0), self.options.max_age_s / 2)

    def _due(self, view: HeadView, level: int, shrink: float) -> Decode:
        if view.held_level is None or view.errors.levels[level] != view.held_level:
            return "both"
        if view.age_s < self._interval_s(view, shrink) - FACE_S / 4:
            return "none"
        if view.latent_change > self.options.least_change:
            return "both"
        if view.latent_change > 0 and view.age_s >= self.options.max_age_s:
            return "both"
        return "expression" if view.view_turn_rad > 0 else "none"

    def _head_s(self, view: HeadView, mesh: int) -> float:
        draw = self.costs.draw
        pixels = view.visible_px if view.drawn_px is None else view.drawn_px
        return draw.pixel_s * pixels + draw.triangle_s * view.num_views * view.num_triangles[mesh]

    def _draw_s(self, seen: Sequence[HeadView], shrink: float) -> float:
        return (self.costs.draw.frame_s if seen else 0.0) + sum(
            self._head_s(view, self._places(view, shrink)[1]) for view in seen
        )

    def _mean_s(self, seen: Sequence[HeadView], shrink: float, frame_s: float) -> float:
        """What a frame costs on average if heads count as so many times smaller."""
        return self._draw_s(seen, shrink) + sum(
            self.costs.decode_s(
                view.model, view.errors.levels[self._places(view, shrink)[0]], "both"
            )
            * min(frame_s / self._interval_s(view, shrink), 1.0)
            for view in seen
        )

    def _unseen(self, view: HeadView, now: float) -> Choice:
        is_wanted = now - self._seen_s[view.slot] < HOLD_S
        level = view.errors.levels[0] if view.held_level is None else view.held_level
        return Choice(level, "none", level, MAX_LAYER if is_wanted else None, 0.0, 0.0, False)
