"""Which heads a frame draws, where and with what: from placements and cameras to what the passes
take, and from there to counts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from pica_client.render.gpu_avatar import Body
from pica_client.render.gpu_maps import MapSeries, MapView, whole_map
from pica_client.render.gpu_program import UNIT_POSITION
from pica_client.render.gpu_textured import TexturedHead
from pica_client.render.passes import (
    DecodedHead,
    PaintedHead,
    Place,
    rect_in_view,
)
from pica_client.render.redraw import HeadKey, PixelRect, area_px, common_part
from pica_client.render.scene import Placement, clip_from_head, screen_rect
from pica_core.avatar.file import Avatar
from pica_core.camera import Camera

MAX_HEADS = 255
"""Heads that a frame draws, both eyes together; further ones are left out: a head's number fits 8
bits."""
MAX_FADE = 0.75
"""A head that has faded completely can still be made out."""


@dataclass(frozen=True, kw_only=True, slots=True)
class HeadStats:
    """What one head of one view took."""

    slot: str
    level: int
    """Level of its mesh; 0 for a placeholder or a textured head."""
    num_triangles: int
    """0 of a head that stayed as it was."""
    shaded_pixels: int | None
    """Pixels that were decoded, or those of a textured head, which colours a pixel again where it
    overlaps itself; None unless asked for."""
    textured_pixels: int | None
    """Pixels of what does not change with the face; None unless asked for."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DrawStats:
    """What one frame drew; counts, not times. What stayed from the frame before is not drawn."""

    num_avatars: int
    """Avatars on the screen with decoded maps."""
    num_placeholders: int
    num_triangles: int
    num_draw_calls: int
    drawn_share: float
    """The part of the heads' rectangles that was drawn, 0 to 1."""
    shaded_pixels: int | None
    """Pixels that pixel decoders coloured; None unless asked for."""
    textured_pixels: int | None
    """Pixels of what does not change with the faces; None unless asked for."""
    heads: tuple[HeadStats, ...]
    """Of the heads that are on the screen; an avatar that both eyes see is there twice, as is one
    while two of its levels are mixed."""


@dataclass(slots=True, eq=False)
class RenderSlot:
    """What a renderer keeps under one name: an avatar, a textured head, or nothing yet."""

    avatar: Avatar | None = None
    body: Body | None = None
    maps: tuple[MapSeries, MapSeries] | None = None
    """Maps of positions, and of expressions."""
    textured: TexturedHead | None = None
    version: int = 0
    """Never the same for two contents of a slot."""


View = tuple[Camera, PixelRect]
"""A camera and the part of the image that it fills."""


@dataclass(frozen=True, slots=True, eq=False)
class DrawList:
    """The heads of one frame that are on the screen."""

    decoded: list[DecodedHead] = field(default_factory=list)
    painted: list[PaintedHead] = field(default_factory=list)

    @property
    def heads(self) -> list[DecodedHead | PaintedHead]:
        """The decoded heads, then the painted ones."""
        return [*self.decoded, *self.painted]


def list_heads(
    slots: Mapping[str, RenderSlot],
    placements: Sequence[Placement],
    views: Sequence[View],
    placeholder: Body,
) -> DrawList:
    """Find what is on the screen, in the order of views and placements; unknown slots are left
    out."""
    listed = DrawList()
    for view in views:
        for placement in placements:
            entry = slots.get(placement.slot)
            num_listed = len(listed.decoded) + len(listed.painted)
            if entry is None or num_listed + 1 >= MAX_HEADS:  # one may take two numbers
                continue
            # Decoded heads count upwards, textured ones downwards from the end.
            is_painted = entry.textured is not None and entry.textured.has_maps
            number = MAX_HEADS - len(listed.painted) if is_painted else len(listed.decoded) + 1
            for head in _arrange(entry, placeholder, placement, view, number):
                if isinstance(head, DecodedHead):
                    listed.decoded.append(head)
                else:
                    listed.painted.append(head)
    return listed


def keys_of(listed: DrawList, slots: Mapping[str, RenderSlot]) -> list[HeadKey]:
    """What the pixels of each head depend on, besides the room."""
    keys = []
    for head in listed.heads:
        place = head.place
        look: tuple[object, ...] = (slots[head.slot].version, place.matrix.tobytes(), place.shown)
        mark = 0
        if isinstance(head, DecodedHead):
            mark = head.mark
            vertices = head.mesh.vertices[0].glo
            maps = head.position.key, head.expression and head.expression.key
            look = (*look, head.share, vertices, maps)
        keys.append(HeadKey((head.slot, head.number, mark, place.view), look, place.rect))
    return keys


def heads_within(listed: DrawList, part: PixelRect) -> DrawList:
    """The heads that reach into a part of the image."""

    def reaches(head: DecodedHead | PaintedHead) -> bool:
        return area_px(common_part(head.place.rect, part)) > 0

    return DrawList(
        [head for head in listed.decoded if reaches(head)],
        [head for head in listed.painted if reaches(head)],
    )


@dataclass(slots=True)
class HeadCounts:
    """What one head of a frame took, all parts of the image together."""

    num_drawn: int = 0
    """Parts that it was drawn in."""
    shaded: int = 0
    """Pixels of its decoder, or of its texture if it is a textured head."""
    textured: int = 0


def count_draws(
    listed: DrawList,
    counts: Sequence[HeadCounts],
    parts: Sequence[PixelRect],
    *,
    is_smooth: bool,
    is_counted: bool,
) -> DrawStats:
    """What a frame drew of its heads, with the counts of each and the parts that were drawn.

    Args:
        is_counted: Pixels were counted.
    """
    heads = [
        HeadStats(
            slot=head.slot,
            level=head.mesh.level,
            num_triangles=count.num_drawn * head.mesh.num_triangles,
            shaded_pixels=count.shaded if is_counted else None,
            textured_pixels=count.textured if is_counted else None,
        )
        for head, count in zip(listed.heads, counts, strict=True)
    ]
    num_placeholders = sum(head.expression is None for head in listed.decoded)
    num_second = sum(head.number != head.mark for head in listed.decoded)
    decoded, painted = counts[: len(listed.decoded)], counts[len(listed.decoded) :]
    rects = [head.place.rect for head in listed.heads]
    drawn_px = sum(area_px(common_part(rect, part)) for rect in rects for part in parts)
    return DrawStats(
        num_avatars=len(heads) - num_placeholders - num_second,
        num_placeholders=num_placeholders,
        num_triangles=sum(head.num_triangles for head in heads),
        num_draw_calls=sum(
            count.num_drawn * (2 + 2 * is_smooth + (head.mesh.static is not None))
            for head, count in zip(listed.decoded, decoded, strict=True)
        )
        + (1 + 2 * is_smooth) * sum(count.num_drawn for count in painted),
        drawn_share=drawn_px / max(sum(map(area_px, rects)), 1),
        shaded_pixels=sum(count.shaded for count in decoded) if is_counted else None,
        textured_pixels=sum(count.textured for count in decoded) if is_counted else None,
        heads=tuple(heads),
    )


_Shown = tuple[int, MapView, MapView | None]
"""A level, its positions and its expressions."""


def _arrange(
    entry: RenderSlot, placeholder: Body, placement: Placement, view: View, number: int
) -> list[DecodedHead | PaintedHead]:
    """One head in one view: none if it is not on the screen, two while levels are mixed."""
    textured = entry.textured if entry.textured and entry.textured.has_maps else None
    maps = entry.maps if entry.maps and all(series.level for series in entry.maps) else None
    body = entry.body if entry.body and maps else placeholder
    camera, part = view
    matrix = clip_from_head(camera, placement.world_from_head)
    bounds = textured or body
    covered = screen_rect(matrix, bounds.low_m, bounds.high_m)
    if covered is None:
        return []
    place = Place(
        matrix=matrix,
        view=part,
        rect=rect_in_view(covered, part),
        shown=(*bounds.fade_m, 1 - min(max(placement.fade, 0.0), 1.0) * MAX_FADE),
    )
    if textured is not None:
        return [PaintedHead(slot=placement.slot, place=place, number=number, mesh=textured)]
    blend = min(max(placement.blend, 0.0), 1.0)
    newest: _Shown
    before: _Shown
    if maps is None:
        newest = before = (0, whole_map(body.textures[UNIT_POSITION]), None)
        blend = 1.0
    else:
        position, expression = maps
        newest = (position.level, position.newest, expression.newest)
        before = (position.level_before, position.before, expression.before)
        if placement.is_same_maps:
            before = newest
        elif before == newest:
            blend = 1.0
    layers = (
        (*newest, placement.mesh_level, (0.0, blend)),
        (*before, placement.mesh_before, (blend, 1.0)),
    )
    heads: list[DecodedHead | PaintedHead] = []
    for level, shape, codes, mesh_level, share in layers:
        if share[0] == share[1]:
            continue
        head = DecodedHead(
            slot=placement.slot,
            place=place,
            number=number + len(heads),
            mark=number,
            share=share,
            body=body,
            mesh=body.mesh(level, mesh_level),
            position=shape,
            expression=codes,
        )
        heads.append(head)
    return heads
