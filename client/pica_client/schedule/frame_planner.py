"""Between the scene and the scheduler: what each head looks like now, and what its plan asks for.

    driver = FramePlanner(Scheduler())
    plan = driver.plan(heads, cameras, size_px, budget_s, now)
    for slot, request in driver.requests(plan): pool.submit(slot, request)
    ...
    driver.note_decoded(result, upload_s, now)       # what it cost, and that its maps are shown now
    placement = driver.dressed(placement, now)       # its mesh, how far it blends
    driver.note_drawn(stats, draw_s)

The scheduler knows numbers; this knows matrices, latents and what was asked of the decoders. It
remembers of each head which latent its maps are made of and from where it was looked at then, so
that it can say how far both have moved. Pure: no GPU, no clock, no threads.

When maps of another level arrive, or the mesh changes, the new ones fade in over `BLEND_S`: a level
that comes and goes is never a jump of the picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pica_client.decode.pool import DecodeRequest, DecodeResult
from pica_client.render.scene import FAR_M, NEAR_M, Placement
from pica_client.schedule.error_model import ErrorModel
from pica_client.schedule.height_rule import HeightRule
from pica_client.schedule.scheduler import Choice, HeadView, Plan, Scheduler
from pica_client.schedule.visibility import PlacedHead, Sight, look, merge_eyes
from pica_core.avatar.file import Avatar
from pica_core.avatar.levels import default_errors
from pica_core.avatar.spec import LATENT_SHAPE
from pica_core.camera import Camera
from pica_core.types import FloatArray

BLEND_S = 0.12
"""How long maps of another level take to fade in (chosen: the eye sees no step, and the mixed face
is gone before it could lag behind the voice)."""
SPEED_SMOOTHING_S = 0.05
"""Over which the speed of a head on the screen is averaged."""
UNLIKE = 1e3
"""Change of a latent that nothing can be compared with."""
LEAST_TURN = 1e-3
"""Radians; a smaller turn of the view is the rounding of its direction."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SceneHead:
    """One head with a face, in the frame that begins."""

    slot: str
    avatar: Avatar
    world_from_head: FloatArray
    """``[4, 4]``."""
    latent: FloatArray
    """What it should show. ``[8, 8, 4]``."""
    captured_us: int = 0
    """Handed through to the decode."""
    is_stale: bool = False
    """Whether it is drawn faded because its stream fell silent."""


@dataclass(slots=True, eq=False)
class _Entry:
    """What is remembered of one head."""

    avatar: Avatar
    errors: ErrorModel
    num_triangles: tuple[int, ...]
    model: str
    latent: FloatArray | None = None
    """Of the maps that were asked for last."""
    view: FloatArray | None = None
    """From where their expression map is seen."""
    level: int | None = None
    asked_s: float = -math.inf
    captured_us: int = 0
    shown_level: int | None = None
    shown_mesh: int | None = None
    mesh_before: int | None = None
    """Of what fades out."""
    is_same_maps: bool = False
    """Whether that are the same maps."""
    blend_from_s: float = -math.inf
    centre_px: tuple[float, float] | None = None
    speed_px_s: float = 0.0
    choice: Choice | None = None

    def fade(self, now: float, *, is_same_maps: bool) -> None:
        """What is shown now fades out."""
        self.mesh_before, self.is_same_maps = self.shown_mesh, is_same_maps
        self.blend_from_s = now


class FramePlanner:
    """Plans frames of a scene.

    Attributes:
        scheduler: Whose plans these are.
    """

    def __init__(self, scheduler: Scheduler | HeightRule) -> None:
        self.scheduler = scheduler
        self._entries: dict[str, _Entry] = {}
        self._heads: dict[str, SceneHead] = {}
        self._views: dict[str, FloatArray] = {}
        self._sights: dict[str, Sight] = {}
        self._planned_s = -math.inf

    def plan(
        self,
        heads: Sequence[SceneHead],
        cameras: Sequence[Camera],
        size_px: tuple[int, int],
        budget_s: float,
        now: float,
    ) -> Plan:
        """Say what everybody gets in the frame that begins now.

        Args:
            heads: Everybody who has a face, in any order.
            cameras: One, or both eyes'.
            size_px: Columns and rows of one eye's image.
            budget_s: For decoding, uploads and drawing, seconds.
            now: The time.
        """
        frame_s = now - self._planned_s
        self._planned_s = now
        self._entries = {head.slot: self._entry(head) for head in heads}
        self._heads = {head.slot: head for head in heads}
        self._views = _view_directions(heads, cameras)
        sights = self._look(heads, cameras, size_px)
        moved = self._moved(heads)
        views = [
            self._head_view(head, sights[head.slot], *moved[head.slot], frame_s, now)
            for head in heads
        ]
        plan = self.scheduler.plan(views, budget_s, now)
        for slot, choice in plan.choices.items():
            self._entries[slot].choice = choice
        return plan

    def requests(self, plan: Plan, now: float) -> list[tuple[str, DecodeRequest]]:
        """What to decode for a plan of `plan`, the nearest heads first; they count as asked for."""
        found = []
        for slot, choice in plan.choices.items():
            if choice.decode == "none":
                continue
            entry, head, view = self._entries[slot], self._heads[slot], self._views[slot]
            latent, captured_us = head.latent, head.captured_us
            if choice.decode == "expression" and entry.latent is not None:
                # The position map stays: both must be of the same face.
                latent, captured_us = entry.latent, entry.captured_us
            request = DecodeRequest(latent, view, captured_us, choice.level, choice.decode)
            found.append((slot, request))
            entry.latent, entry.view, entry.level = latent, view, choice.level
            entry.asked_s, entry.captured_us = now, captured_us
        return found

    def is_visible(self, slot: str) -> bool:
        """Whether a head could be seen in the planned frame; False for one without a face."""
        sight = self._sights.get(slot)
        return sight is not None and sight.is_visible

    def note_decoded(self, result: DecodeResult, upload_s: float, now: float) -> None:
        """Learn what a decode and its upload cost; its maps are drawn from now on."""
        entry = self._entries.get(result.slot)
        if entry is None or result.maps is None:
            return
        costs = self.scheduler.costs
        costs.observe_decode(entry.model, result.level, result.parts, result.decode_s)
        costs.observe_upload(result.level, result.parts, upload_s)
        if entry.shown_level is not None and entry.shown_level != result.level:
            entry.fade(now, is_same_maps=False)
            entry.shown_mesh = None
        entry.shown_level = result.level

    def note_drawn(self, num_triangles: int, shaded_px: float, draw_s: float) -> None:
        """Learn what drawing a frame cost.

        Args:
            num_triangles: That went through the vertex stage.
            shaded_px: That the pixel decoder ran on.
            draw_s: Until the GPU was done.
        """
        self.scheduler.costs.observe_draw(
            num_triangles=num_triangles, shaded_px=shaded_px, seconds=draw_s
        )

    def expected_shading_px(self) -> float:
        """Pixels that the pixel decoder runs on in the planned frame, as far as one can tell
        without counting them."""
        return sum(
            sight.drawn_px
            for slot, entry in self._entries.items()
            if entry.choice is not None and (sight := self._sights.get(slot)) is not None
        )

    def dressed(self, placement: Placement, now: float) -> Placement:
        """A placement as the plan wants it drawn: its mesh, and how far it blends."""
        entry = self._entries.get(placement.slot)
        if entry is None or entry.choice is None:
            return placement
        choice = entry.choice
        # A mesh that is meant for maps still to come waits for them.
        if choice.level == entry.shown_level and choice.mesh_level != entry.shown_mesh:
            if entry.shown_mesh is not None:
                entry.fade(now, is_same_maps=True)
            entry.shown_mesh = choice.mesh_level
        return replace(
            placement,
            mesh_level=entry.shown_mesh,
            mesh_before=entry.mesh_before,
            is_same_maps=entry.is_same_maps,
            blend=min((now - entry.blend_from_s) / BLEND_S, 1.0),
        )

    def _look(
        self, heads: Sequence[SceneHead], cameras: Sequence[Camera], size_px: tuple[int, int]
    ) -> dict[str, Sight]:
        # All heads at once: numpy takes as long for one as for five.
        matrices = np.array([head.world_from_head for head in heads])
        eyes = []
        for camera in cameras:
            clip = np.matmul(camera.clip_from_world(NEAR_M, FAR_M), matrices) if heads else ()
            placed = [
                PlacedHead(
                    head.slot,
                    matrix,
                    head.avatar.manifest.bounds_min_m,
                    head.avatar.manifest.bounds_max_m,
                )
                for head, matrix in zip(heads, clip, strict=True)
            ]
            eyes.append(look(placed, size_px, NEAR_M))
        self._sights = merge_eyes(eyes) if len(eyes) > 1 else eyes[0]
        return self._sights

    def _moved(self, heads: Sequence[SceneHead]) -> dict[str, tuple[float, float]]:
        """How far each head's latent and view have moved since what was asked for: RMS, radians.
        A latent of a wrong shape has moved far: the decoder is to refuse it."""
        moved = {
            head.slot: (0.0 if head.latent.shape == LATENT_SHAPE else UNLIKE, 0.0) for head in heads
        }
        held = [(head, self._entries[head.slot]) for head in heads]
        known = [
            (head, each.latent, each.view)
            for head, each in held
            if each.latent is not None and each.latent.shape == head.latent.shape == LATENT_SHAPE
        ]
        if not known:
            return moved
        now = np.array([head.latent for head, _, _ in known]).reshape(len(known), -1)
        then = np.array([latent for _, latent, _ in known]).reshape(len(known), -1)
        changes = np.sqrt(np.square(now - then).mean(axis=1)).tolist()
        seen_now = np.array([self._views[head.slot] for head, _, _ in known])
        cosines = (seen_now * np.array([view for _, _, view in known])).sum(axis=1).tolist()
        for (head, _, _), change, cosine in zip(known, changes, cosines, strict=True):
            moved[head.slot] = (change, math.acos(min(max(cosine, -1.0), 1.0)))
        return moved

    def _entry(self, head: SceneHead) -> _Entry:
        entry = self._entries.get(head.slot)
        if entry is not None and entry.avatar is head.avatar:
            return entry
        self.scheduler.forget(head.slot)
        avatar = head.avatar
        alike = next((each for each in self._entries.values() if each.avatar is avatar), None)
        if alike is not None:
            return _Entry(avatar, alike.errors, alike.num_triangles, alike.model)
        return _Entry(
            avatar=avatar,
            errors=ErrorModel(avatar.level_errors or default_errors(avatar.levels)),
            num_triangles=tuple(len(avatar.level_faces(level)) for level in avatar.levels),
            model=f"{avatar.manifest.variant} {avatar.spec.block}",
        )

    def _head_view(
        self,
        head: SceneHead,
        sight: Sight,
        change: float,
        turn_rad: float,
        frame_s: float,
        now: float,
    ) -> HeadView:
        entry = self._entries[head.slot]
        before, entry.centre_px = entry.centre_px, sight.centre_px if sight.is_visible else None
        if before is None or entry.centre_px is None or not 0 < frame_s < 1:
            entry.speed_px_s = 0.0
        else:
            speed = math.dist(before, entry.centre_px) / frame_s
            weight = 1 - math.exp(-frame_s / SPEED_SMOOTHING_S)
            entry.speed_px_s += weight * (speed - entry.speed_px_s)
        return HeadView(
            slot=head.slot,
            errors=entry.errors,
            num_triangles=entry.num_triangles,
            is_visible=sight.is_visible,
            visible_px=sight.visible_px,
            head_px=sight.head_px,
            hidden_ratio=sight.hidden_ratio,
            distance_m=sight.distance_m,
            drawn_px=sight.drawn_px,
            num_views=max(sight.num_views, 1),
            held_level=entry.level,
            latent_change=change,
            view_turn_rad=turn_rad if turn_rad > LEAST_TURN else 0.0,
            age_s=now - entry.asked_s,
            speed_px_s=entry.speed_px_s,
            is_stale=head.is_stale,
            model=entry.model,
        )


def _view_directions(
    heads: Sequence[SceneHead], cameras: Sequence[Camera]
) -> dict[str, FloatArray]:
    """From where each head is seen, see `scene.view_direction`; by both eyes from between them."""
    if not heads:
        return {}
    middle = np.mean([camera.centre_m for camera in cameras], axis=0)
    matrices = np.array([head.world_from_head for head in heads], np.float64)
    towards = middle - matrices[:, :3, 3]
    seen = np.matmul(towards[:, None, :], matrices[:, :3, :3])[:, 0]
    lengths = np.linalg.norm(seen, axis=1, keepdims=True)
    ahead = np.array([0.0, 0.0, 1.0])
    views = np.where(lengths < 1e-9, ahead, seen / np.maximum(lengths, 1e-9)).astype(np.float32)
    return {head.slot: view for head, view in zip(heads, views, strict=True)}
