"""Which heads a frame shows, where and with what: from placements and cameras to what the passes
take, and from there to counts.
"""

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

import moderngl
import numpy as np

from pica_client.render.gpu_avatar import Body, HeadMaps, Mesh
from pica_client.render.gpu_plain import TexturedHead
from pica_client.render.layers import PixelRect, area_px, common_part, viewport
from pica_client.render.scene import FAR_M, NEAR_M, Placement, Rect, screen_rects
from pica_core.avatar.bust import WHOLE_M
from pica_core.avatar.file import Avatar
from pica_core.camera import Camera
from pica_core.types import FloatArray

MAX_FADE = 0.75
"""A head that has faded completely can still be made out."""
EDGE_PX = 1
"""A smoothed silhouette reaches so far beyond the pixels that a head covers."""
NO_ROWS = (-2.0, -1.0, -2.0, -1.0)
"""Those of a head that does not fade."""
View = tuple[Camera, PixelRect]
"""A camera and the part of the image that it fills."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DrawStats:
    """What one frame drew; counts, not times. What stayed from the frame before is not drawn."""

    num_avatars: int
    """Avatars on the screen with decoded maps."""
    num_placeholders: int
    num_triangles: int
    drawn_share: float
    """The part of the heads' rectangles that was drawn, 0 to 1."""
    shaded_pixels: int | None
    """Pixels that pixel decoders coloured; None unless asked for."""
    textured_pixels: int | None
    """Pixels of what has a texture; None unless asked for."""
    drawn: tuple[str, ...]
    """Slots of the heads that did not stay as they were; one that both eyes see is there twice."""


@dataclass(slots=True, eq=False)
class RenderSlot:
    """What a renderer keeps under one name: an avatar, a textured head, or nothing yet."""

    avatar: Avatar | None = None
    body: Body | None = None
    """None for a textured head before its first face, too."""
    maps: HeadMaps | None = None
    """Of an avatar."""
    textured: TexturedHead | None = None
    version: int = 0
    """Never the same for two contents of a slot."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ShownHead:
    """One head in one view of a frame."""

    slot: str
    view: PixelRect
    """The part of the image that the view fills."""
    rect: PixelRect
    """The part of the image that the head may cover."""
    matrix: FloatArray
    """Clip space of the view from the head frame, ``[4, 4]``."""
    scale: float
    """Share of the image's resolution that it is drawn with."""
    opacity: float
    """Before the room, 0 to 1."""
    fading_rows: tuple[float, ...]
    """Rows of the image at which nothing is left of that side of it which fades first, and from
    which all is there; then those of the side that fades last."""
    body: Body
    mesh: Mesh
    position: moderngl.Texture | None
    expression: moderngl.Texture | None
    """None where nothing is decoded."""
    look: Hashable
    """All that its layer depends on."""

    @property
    def fades(self) -> bool:
        """Whether the room is seen through it."""
        return self.opacity < 1 or self.body.fade_m != WHOLE_M

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows that it is drawn in."""
        columns, rows = viewport(self.rect)[2:]
        return math.ceil(self.scale * columns), math.ceil(self.scale * rows)


def list_heads(
    slots: Mapping[str, RenderSlot],
    placements: Sequence[Placement],
    views: Sequence[View],
    placeholder: Body,
) -> list[ShownHead]:
    """Find what is on the screen, in the order of views and placements; unknown slots are left
    out."""
    known = [placement for placement in placements if placement.slot in slots]
    if not known:
        return []
    bodies = [_body(slots[placement.slot], placeholder) for placement in known]
    outlines_m = np.array([body.outline_m for body in bodies])
    world_from_head = np.array([placement.world_from_head for placement in known])
    listed: list[ShownHead] = []
    for camera, part in views:
        matrices = np.matmul(camera.clip_from_world(NEAR_M, FAR_M), world_from_head)
        rects = screen_rects(matrices, outlines_m)
        fades = _fading_rows(bodies, matrices, part)
        for placement, body, matrix, covered, rows in zip(
            known, bodies, matrices, rects, fades, strict=True
        ):
            if covered is not None:
                left, bottom, right, top = rect_in_view(covered, part)
                grown = left - EDGE_PX, bottom - EDGE_PX, right + EDGE_PX, top + EDGE_PX
                entry, rect = slots[placement.slot], common_part(grown, part)
                listed.append(_shown(entry, body, placement, matrix, part, rect, rows))
    return listed


def count_draws(
    heads: Sequence[ShownHead],
    drawn: Sequence[ShownHead],
    pixels: tuple[int, int] | None,
    placeholder: Body,
) -> DrawStats:
    """What a frame drew of its heads.

    Args:
        drawn: Those that did not stay as they were.
        pixels: That were decoded, and that were textured; None if they were not counted.
    """
    num_placeholders = sum(head.body is placeholder for head in heads)
    shaded, textured = pixels or (None, None)
    share = sum(area_px(head.rect) for head in drawn) / max(
        sum(area_px(head.rect) for head in heads), 1
    )
    return DrawStats(
        num_avatars=len(heads) - num_placeholders,
        num_placeholders=num_placeholders,
        num_triangles=sum(head.mesh.num_triangles for head in drawn),
        drawn_share=share,
        shaded_pixels=shaded,
        textured_pixels=textured,
        drawn=tuple(head.slot for head in drawn),
    )


def rect_in_view(clip: Rect, view: PixelRect) -> PixelRect:
    """The whole pixels of a view that touch a rectangle of its clip space."""
    left, bottom, width, height = viewport(view)
    return (
        left + math.floor((clip[0] + 1) / 2 * width),
        bottom + math.floor((clip[1] + 1) / 2 * height),
        left + math.ceil((clip[2] + 1) / 2 * width),
        bottom + math.ceil((clip[3] + 1) / 2 * height),
    )


def _body(entry: RenderSlot, placeholder: Body) -> Body:
    """What is drawn of a slot: an avatar needs its maps."""
    is_there = entry.maps is None or entry.maps.level
    return entry.body if entry.body and is_there else placeholder


def _shown(
    entry: RenderSlot,
    body: Body,
    placement: Placement,
    matrix: FloatArray,
    view: PixelRect,
    rect: PixelRect,
    fading_rows: tuple[float, ...],
) -> ShownHead:
    level, position, expression = 0, None, None
    if entry.maps is not None and body is entry.body:
        level, (position, expression) = entry.maps.level, entry.maps.newest
    mesh = body.meshes[level]
    return ShownHead(
        slot=placement.slot,
        view=view,
        rect=rect,
        matrix=matrix,
        scale=placement.scale,
        fading_rows=fading_rows,
        opacity=1 - min(max(placement.fade, 0.0), 1.0) * MAX_FADE,
        body=body,
        mesh=mesh,
        position=position,
        expression=expression,
        look=(entry.version, matrix.tobytes(), rect, placement.scale),
    )


def _fading_rows(
    bodies: Sequence[Body], matrices: FloatArray, view: PixelRect
) -> list[tuple[float, ...]]:
    """See `ShownHead.fading_rows`; of all heads of a view ``[N]``."""
    # All heads at once: numpy takes as long for one as for twenty.
    low, high, fade = (
        np.array([getattr(body, name) for body in bodies]) for name in ("low_m", "high_m", "fade_m")
    )
    sides = np.stack([low, high], axis=1)  # [N, 2, 3]
    corners = np.empty((len(bodies), 2, 2, 2, 4))  # fade, x, z
    corners[..., 0] = sides[:, None, :, None, 0]
    corners[..., 1] = fade[:, :, None, None]
    corners[..., 2] = sides[:, None, None, :, 2]
    corners[..., 3] = 1.0
    y, w = np.einsum("nfxzk,nrk->rnfxz", corners, matrices[:, [1, 3]])
    _, bottom, _, rows = viewport(view)
    heights = bottom + rows * (np.clip(y / np.maximum(w, NEAR_M), -2, 2) + 1) / 2
    most, least = heights.max(axis=(2, 3)), heights.min(axis=(2, 3))
    found = np.stack([most[:, 0], most[:, 1] + 1, least[:, 0], least[:, 1] + 1], axis=1)
    return [
        NO_ROWS if body.fade_m == WHOLE_M else tuple(each)
        for body, each in zip(bodies, found.tolist(), strict=True)
    ]
