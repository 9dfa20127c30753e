"""What every avatar gets in a frame: decode level, mesh, layer of its stream. Pure.

    scheduler = Scheduler()
    plan = scheduler.plan(views, budget_s=0.008, now=now)
    plan.choices["ada"].level, .decode, .mesh_level, .wanted_layer

Theory of operation. What counts is the squared error over the display: the MSE of a head times the
pixels of it that can be seen. Of each head the scheduler knows what each choice leaves
(`error_model`) and what it costs on this machine (`cost_model`). A ladder leads up from the least
that a head can get: keep the maps, drawn with few triangles or more; make a fresh expression map
(the view has turned); decode both maps at one of the levels (the face has moved), the full ones
again for few triangles or more.

The budget buys the rungs that save most error per millisecond (`detail_ladder`). What follows, and
what the tests hold it to:

- The floor is the cheapest choice of everybody. Whenever that fits, the budget is kept.
- More budget never means more error: a rung that newly fits is worth more per millisecond than all
  that had been taken in its place.
- The order of heads does not matter: ties go to the nearer, then by name.
- From a nearer head nothing is kept that a farther one gets which moves as much: when its rung does
  not fit, those above it are closed to the other.
- Nothing is bought that cannot be seen: maps and mesh finer than the screen shows count no more
  than those that just do, so the cheapest of them is taken, whatever the budget.
- Who cannot be seen costs nothing: no decode, no pixel, and after a while no stream.

Nobody starves: maps whose error can be seen are not kept longer than `max_age_s`; the oldest are
decoded anew at the lowest level, some each frame, whatever the budget says.

Levels do not flap: how much detail a head can use follows its size down late and with a margin, and
after a level that the budget took away the next try waits, longer each time.

Where it ends: errors of maps, mesh and age are added, which bounds their sum from above; decoding
counts as if it stood in line with drawing, though both run side by side. Pixels are not for sale:
shading every second one in both directions was tried and cost as much as it saved.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from pica_client.schedule.config import SchedulerOptions
from pica_client.schedule.cost_model import CostModel
from pica_client.schedule.error_model import ErrorModel, Extra
from pica_client.schedule.lod_knapsack import Climber, Decode, Rung, climb, hull
from pica_protocol.limits import MAX_LAYER

__all__ = ["Choice", "HeadView", "Plan", "Scheduler", "SchedulerOptions"]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HeadView:
    """One head as it stands before the cameras, and what has been decoded of it."""

    slot: str
    errors: ErrorModel
    """Of its avatar; its levels are what can be chosen."""
    num_triangles: tuple[int, ...]
    """Of the mesh of each level."""
    is_visible: bool
    visible_px: float = 0.0
    """Pixels that can be seen, in the eye that sees most."""
    head_px: float = 0.0
    """Height on the screen."""
    hidden_ratio: float = 0.0
    """Share that nearer heads hide."""
    distance_m: float = 1.0
    """Says who is nearer where pixels do not."""
    drawn_px: float | None = None
    """Pixels to shade in all eyes together; None is `visible_px`."""
    num_views: int = 1
    """Eyes that draw it; it is decoded once for all."""
    held_level: int | None = None
    """Level of the maps that were made last, or are being made; None before the first."""
    latent_change: float = 0.0
    """Root mean square over the 256 numbers, between the latent of now and that of these maps."""
    view_turn_rad: float = 0.0
    """How far the view has turned since their expression map."""
    age_s: float = math.inf
    """Since they were asked for."""
    speed_px_s: float = 0.0
    """Of its middle over the screen."""
    is_stale: bool = False
    """Whether its stream has fallen silent, so that it is drawn faded."""
    model: str = ""
    """What names its costs in the cost model."""

    def __post_init__(self) -> None:
        numbers = (
            *(self.visible_px, self.head_px, self.hidden_ratio, self.latent_change),
            *(self.view_turn_rad, self.speed_px_s, self.drawn_px or 0.0),
        )
        if not (min(numbers) >= 0 and sum(numbers) < math.inf):
            raise ValueError(f"head {self.slot}: {numbers} must be finite and at least 0")
        if len(self.num_triangles) != len(self.errors.levels):
            raise ValueError(f"head {self.slot}: {len(self.num_triangles)} meshes for its levels")
        if self.held_level is not None and self.held_level not in self.errors.levels:
            raise ValueError(f"head {self.slot}: holds level {self.held_level}, which it lacks")

    @property
    def has_maps(self) -> bool:
        """Whether something of it can be drawn."""
        return self.held_level is not None


class Choice(NamedTuple):
    """What one avatar gets in this frame."""

    level: int
    """Of the maps that are drawn once this frame's decode is there."""
    decode: Decode
    """What to decode now, at `level`; "expression" with the latent of the maps that are there."""
    mesh_level: int
    """Of the triangles: that of the maps; with full maps also coarser ones, where the head cannot
    use more or the budget has no room for them."""
    wanted_layer: int | None
    """Highest layer of its stream to ask for; None is no stream at all."""
    error: float
    """Expected MSE over its visible pixels, against the full model with supersampling."""
    cost_s: float
    """Its share of the plan's cost."""
    is_limited: bool
    """Whether the budget kept something from it that could be seen."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Plan:
    """What everybody gets in this frame."""

    choices: Mapping[str, Choice]
    """By slot."""
    budget_s: float
    cost_s: float
    """Of decodes, uploads and drawing, as the cost model expects it."""
    floor_s: float
    """Of the least that everybody gets; if that is above the budget, it is all there is."""
    error: float
    """Mean squared error over all pixels of heads that can be seen."""
    num_steps: int
    """Rungs looked at: what planning itself costs."""

    @property
    def limited(self) -> tuple[str, ...]:
        """Slots from which the budget kept something that could be seen."""
        return tuple(slot for slot, choice in self.choices.items() if choice.is_limited)


@dataclass(slots=True, eq=False)
class _Memory:
    """What is remembered of one head from frame to frame."""

    seen_s: float
    """When it could last be seen."""
    maps: _Cap = field(default_factory=lambda: _Cap())
    mesh: _Cap = field(default_factory=lambda: _Cap())


@dataclass(slots=True, eq=False)
class _Cap:
    """How fine a level's maps, or its mesh, may be."""

    needed: int = 0
    """Place of the coarsest that is as good as can be seen."""
    small_since_s: float = math.inf
    planned: int = -1
    """Place of what was planned last; -1 before the first."""
    pause: _Pause = field(default_factory=lambda: _Pause())

    def follow(
        self, extra: Sequence[float], unseen: float, now: float, options: SchedulerOptions
    ) -> None:
        """Follow the size of the head: up at once, and down to what has been clearly good enough
        for a while.

        Args:
            extra: MSE that each place leaves over the finest.
            unseen: How much of it cannot be seen.
            now: The time.
            options: Of the scheduler.
        """
        needed = next(i for i, mse in enumerate(extra) if mse <= unseen)
        clearly = next(i for i, mse in enumerate(extra) if mse <= options.margin * unseen)
        if self.planned < 0 or needed > self.needed:
            self.needed = needed
        if clearly >= self.needed:
            self.small_since_s = math.inf
        elif self.small_since_s == math.inf:
            self.small_since_s = now
        elif now - self.small_since_s >= options.lower_after_s:
            self.needed, self.small_since_s = clearly, math.inf

    def top(self, count: int, now: float) -> int:
        """Place of the finest that may be planned now."""
        return self.planned if self.planned >= 0 and self.pause.lasts(now) else count - 1


@dataclass(slots=True, eq=False)
class _Pause:
    """After the budget took something away: how long it is not tried again."""

    begin_s: float = -math.inf
    length_s: float = 0.0

    def lasts(self, now: float) -> bool:
        return now - self.begin_s < self.length_s

    def begin(self, now: float, options: SchedulerOptions) -> None:
        is_again = now - self.begin_s < options.max_retry_s
        self.length_s = min(2 * self.length_s, options.max_retry_s) if is_again else options.retry_s
        self.begin_s = now


@dataclass(slots=True, eq=False)
class _Head:
    """A visible head while a plan is made."""

    view: HeadView
    memory: _Memory
    weight: float
    """Of its MSE."""
    extra: Extra
    """What motion hides taken off."""
    climber: Climber
    draw_s: float = 0.0
    """Of its pixels."""


class Scheduler:
    """Plans frame after frame; see the module for how.

    Attributes:
        costs: What things cost here; the owner tells it what it measures.
    """

    def __init__(
        self, options: SchedulerOptions | None = None, costs: CostModel | None = None
    ) -> None:
        self.options = options or SchedulerOptions()
        self.costs = costs or CostModel()
        self._memories: dict[str, _Memory] = {}
        self._now = -math.inf

    def plan(self, heads: Sequence[HeadView], budget_s: float, now: float) -> Plan:
        """Say what everybody gets in the frame that begins now.

        Args:
            heads: Everybody in the call, in any order; slots are unique.
            budget_s: What decodes, uploads and drawing of this frame may take, seconds.
            now: The time.
        """
        frame_s = max(now - self._now, 0.0)
        self._now = now
        memories = {
            view.slot: self._memories.get(view.slot) or _Memory(seen_s=now) for view in heads
        }
        self._memories = memories
        seen = sorted((view for view in heads if view.is_visible), key=_nearness)
        overdue = self._overdue(seen, frame_s)
        ranked = [self._head(view, memories[view.slot], view.slot in overdue, now) for view in seen]
        floor_s = self.costs.draw.frame_s if ranked else 0.0
        for head in ranked:
            floor_s += head.climber.rung.cost_s + head.draw_s
        spent_s, num_steps = climb([head.climber for head in ranked], budget_s - floor_s)
        choices = {view.slot: self._unseen(view, now) for view in heads if not view.is_visible}
        error = weight = 0.0
        for head in ranked:
            choice = self._choice(head, now)
            choices[head.view.slot] = choice
            error += choice.error * head.view.visible_px
            weight += head.view.visible_px
        return Plan(
            choices=choices,
            budget_s=budget_s,
            cost_s=floor_s + spent_s,
            floor_s=floor_s,
            error=error / weight if weight > 0 else 0.0,
            num_steps=num_steps,
        )

    def forget(self, slot: str) -> None:
        """Remember nothing of a slot: somebody else is in it now. An unknown one is no error."""
        self._memories.pop(slot, None)

    def _overdue(self, seen: Sequence[HeadView], frame_s: float) -> set[str]:
        """Who is decoded in this frame whatever the budget: the oldest, some each frame."""
        options = self.options
        waiting = [
            view
            for view in seen
            if not view.has_maps
            or (view.age_s >= options.max_age_s / 2 and _age_mse(view) > options.floor_mse)
        ]
        if not waiting:
            return set()
        # Whoever comes of half the age is served within the other half.
        share = min(max(2 * frame_s / options.max_age_s, 0.0), 1.0)
        quota = max(math.ceil(len(seen) * share), 1)
        waiting.sort(key=lambda view: (view.has_maps, -view.age_s, *_nearness(view)))
        return {
            view.slot
            for place, view in enumerate(waiting)
            if place < quota or view.age_s >= options.max_age_s
        }

    def _head(self, view: HeadView, memory: _Memory, is_overdue: bool, now: float) -> _Head:
        options, costs = self.options, self.costs
        extra = view.errors.extra(view.head_px)
        if view.speed_px_s > 0:
            blur = 1 + (view.speed_px_s / options.blur_px_s) ** 2
            maps, meshes = ([mse / blur for mse in part] for part in extra[:2])
            extra = Extra(maps, meshes, extra.own)
        unseen = max(options.floor_mse, options.floor_ratio * extra.own)
        memory.seen_s = now
        # Of what cannot be seen maps take half at most; what they leave is the mesh's.
        memory.maps.follow(extra.maps, unseen / 2, now, options)
        left = unseen - extra.maps[memory.maps.needed]
        memory.mesh.follow(extra.meshes, left, now, options)
        count = len(extra.maps)
        tops = memory.maps.top(count, now), memory.mesh.top(count, now)
        weight = view.visible_px * (options.stale_weight if view.is_stale else 1.0)
        pixels = view.visible_px if view.drawn_px is None else view.drawn_px
        ladder, worths = hull(self._rungs(view, memory, weight, extra, tops, is_overdue))
        climber = Climber(
            nearness=(view.head_px, weight, -view.distance_m, -view.speed_px_s),
            motion=(view.latent_change, view.view_turn_rad, view.age_s),
            ladder=ladder,
            worths=worths,
            is_limited=tops[0] < memory.maps.needed or tops[1] < memory.mesh.needed,
        )
        return _Head(view, memory, weight, extra, climber, costs.draw.pixel_s * pixels)

    def _rungs(
        self,
        view: HeadView,
        memory: _Memory,
        weight: float,
        extra: Extra,
        tops: tuple[int, int],
        is_overdue: bool,
    ) -> list[Rung]:
        """What can be done with a head's maps; at least one thing.

        Args:
            view: Which.
            memory: Of it.
            weight: Of its MSE.
            extra: What choices leave.
            tops: Places of the finest maps that may be decoded now, and of the finest mesh.
            is_overdue: Whether something must be.
        """
        options = self.options
        levels = view.errors.levels
        full = len(levels) - 1
        held = -1 if view.held_level is None else levels.index(view.held_level)
        age_mse = _age_mse(view)
        latent_mse = view.errors.latent_mse_per_unit2 * view.latent_change * view.latent_change
        is_worth_it = age_mse > options.stale_floor_mse or (
            age_mse > 0 and view.age_s >= options.settle_s
        )
        decode_s = self.costs.decode_s
        triangle_s = self.costs.draw.triangle_s * view.num_views
        mesh_s = [triangle_s * count for count in view.num_triangles]
        # Finer than can be seen counts as no better, and so is never bought.
        mesh_mse = [max(mse, extra.meshes[memory.mesh.needed]) for mse in extra.meshes]
        maps_mse = [max(mse, extra.maps[memory.maps.needed]) for mse in extra.maps]
        model, mesh_top = view.model, tops[1]

        def meshes(place: int) -> Iterable[int]:
            return range(mesh_top + 1) if place == full else (place,)

        rungs = []
        if held >= 0:
            if not is_overdue:
                for mesh in meshes(held):
                    error = weight * (maps_mse[held] + mesh_mse[mesh] + age_mse)
                    rungs.append(Rung(mesh_s[mesh], error, (held, 0, mesh), held, "none", mesh))
            is_turned = view.view_turn_rad > 0 and is_worth_it
            if is_turned and (latent_mse <= options.floor_mse or not is_overdue):
                view_s = decode_s(model, levels[held], "expression")
                for mesh in meshes(held):
                    error = weight * (maps_mse[held] + mesh_mse[mesh] + latent_mse)
                    rungs.append(
                        Rung(
                            mesh_s[mesh] + view_s, error, (held, 1, mesh), held, "expression", mesh
                        )
                    )
        is_moved = view.latent_change > 0 and is_worth_it
        for place in range(0 if is_overdue or is_moved else held + 1, tops[0] + 1):
            both_s = decode_s(model, levels[place], "both")
            for mesh in meshes(place):
                error = weight * (maps_mse[place] + mesh_mse[mesh])
                rungs.append(
                    Rung(mesh_s[mesh] + both_s, error, (place, 2, mesh), place, "both", mesh)
                )
        return rungs

    def _choice(self, head: _Head, now: float) -> Choice:
        view, memory, climber = head.view, head.memory, head.climber
        rung, levels = climber.rung, view.errors.levels
        for cap, place in ((memory.maps, rung.place), (memory.mesh, rung.mesh)):
            if climber.is_limited and place < min(cap.planned, cap.needed):
                cap.pause.begin(now, self.options)
            cap.planned = place
        error = rung.error / head.weight if head.weight > 0 else 0.0
        return Choice(
            level=levels[rung.place],
            decode=rung.decode,
            mesh_level=levels[rung.mesh],
            wanted_layer=self._layer(view),
            error=error + head.extra.own,
            cost_s=rung.cost_s + head.draw_s,
            is_limited=climber.is_limited,
        )

    def _unseen(self, view: HeadView, now: float) -> Choice:
        memory = self._memories[view.slot]
        is_wanted = now - memory.seen_s < self.options.wish_hold_s
        level = view.errors.levels[0] if view.held_level is None else view.held_level
        layer = MAX_LAYER if is_wanted else None
        return Choice(level, "none", level, layer, 0.0, 0.0, False)

    def _layer(self, view: HeadView) -> int:
        height = view.head_px * math.sqrt(max(1 - view.hidden_ratio, 0.0))
        for layer, below_px in enumerate(self.options.layer_px):
            if height < below_px:
                return layer
        return MAX_LAYER


def _age_mse(view: HeadView) -> float:
    """What keeping the maps costs."""
    errors, change, turn_rad = view.errors, view.latent_change, view.view_turn_rad
    return (
        errors.latent_mse_per_unit2 * change * change
        + errors.view_mse_per_rad2 * turn_rad * turn_rad
    )


def _nearness(view: HeadView) -> tuple[float, float, float, str]:
    """Sorts near heads first; the order of who comes in does not matter."""
    return (-view.head_px, -view.visible_px, view.distance_m, view.slot)
