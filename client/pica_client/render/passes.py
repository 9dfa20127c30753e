"""The passes of a frame: the images and programs they use, and the order of GL calls.

All rectangles are of the whole image, so that several views can share it.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import moderngl
import numpy as np

from pica_client.render.gpu_avatar import Body, Mesh, MeshPrograms, upload_placeholder
from pica_client.render.gpu_maps import MapView
from pica_client.render.gpu_program import (
    UNIT_EXPRESSION,
    UNIT_POSITION,
    UNIT_ROOM,
    UNIT_SKIN,
    UNIT_STILL,
    UNIT_VISIBLE_UV,
    UNIT_VISIBLE_XYZ,
    build_program,
    clamp,
    set_matrix,
    set_values,
)
from pica_client.render.gpu_textured import TexturedHead
from pica_client.render.redraw import PixelRect
from pica_client.render.room import Room, lens_of
from pica_client.render.shader_source import compose
from pica_core.camera import Camera
from pica_core.types import FloatArray

SMALL_ROOM = (224, 160)
"""Columns and rows that the room is drawn in before it is enlarged, whatever the picture's size: a
view that turns draws it in every frame (llvmpipe, 1280 x 720, five seats: 22 ms at full size)."""
WHOLE = (0.0, 1.0)
"""The share of a head that no other level is mixed into."""


class RenderTargets:
    """All framebuffers of one size, columns and rows."""

    def __init__(self, context: moderngl.Context, size: tuple[int, int]) -> None:
        self.size = size
        self.visible = {
            UNIT_VISIBLE_XYZ: context.texture(size, 4, dtype="f4"),
            # 16 bits a coordinate: 1/7 of an entry of a table of 10,000, while a pixel of a head
            # that fills the screen reaches over six; writing 32 bits takes half as long again
            # (llvmpipe).
            UNIT_VISIBLE_UV: context.texture(size, 2, dtype="nu2"),
        }
        """What the surface pass writes, keyed by texture unit."""
        for texture in self.visible.values():
            clamp(texture, moderngl.NEAREST)
        depth = context.depth_renderbuffer(size)
        self.surface = context.framebuffer(list(self.visible.values()), depth)
        self.depth = context.framebuffer([], depth)
        """The depth of the surface pass alone."""
        self.shaded_image = clamp(context.texture(size, 4))
        self.shaded = context.framebuffer([self.shaded_image])
        self.textured = context.framebuffer([self.shaded_image], depth)
        """The shaded image with the depth of the surface pass, for heads drawn in one pass."""
        smoothed_image = context.texture(size, 4)
        self.smoothed = context.framebuffer([smoothed_image])
        self.marked = context.framebuffer([smoothed_image], depth)
        """The smoothed image with the depth of the surface pass, which by then marks edges."""
        self.final = context.framebuffer([context.texture(size, 4)])
        """What the renderer hands out: others may draw over it, so nothing is kept in it."""
        self.room_image = context.texture(size, 4)
        self.room = context.framebuffer([self.room_image])
        self.small_room_image = clamp(context.texture(SMALL_ROOM, 4, dtype="f2"))
        self.small_room = context.framebuffer([self.small_room_image])
        """What a view of the room is enlarged from."""

    def draw_only(self, part: PixelRect) -> None:
        """Let what comes now change this part of the kept images alone."""
        kept = self.surface, self.depth, self.shaded, self.textured, self.smoothed, self.marked
        for framebuffer in kept:
            framebuffer.scissor = viewport(part)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Place:
    """Where a head is in one view of a frame."""

    matrix: FloatArray
    """Clip space of the view from the head frame, ``[4, 4]``."""
    view: PixelRect
    """The part of the image that the view fills."""
    rect: PixelRect
    """The part of the image that the head may cover."""
    shown: tuple[float, float, float]
    """Heights in the head frame below which nothing and above which all of it is there, metres; and
    its opacity before the room."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class DecodedHead:
    """A head whose pixels are decoded, or the placeholder of one."""

    slot: str
    place: Place
    number: int
    """Its mark in the surface pass, 1 to 255."""
    mark: int
    """Its mark in the image: that of the other level, where two share the pixels of a head."""
    share: tuple[float, float]
    """The part of its pixels that it draws, from and to; (0, 1) is all."""
    body: Body
    mesh: Mesh
    position: MapView
    expression: MapView | None
    """None for a placeholder."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PaintedHead:
    """A head with a texture."""

    slot: str
    place: Place
    number: int
    """Its mark in the image, 1 to 255."""
    mesh: TexturedHead


T = TypeVar("T")


class DrawPasses:
    """All programs that no avatar brings along, and the passes that use them.

    Raises:
        ShaderError: The driver refuses our shaders.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        shared, static = {"SHARED": ""}, {"STATIC": ""}
        mesh, surface = compose("mesh.vert"), compose("surface.frag")
        self.mesh_programs = MeshPrograms(
            whole=build_program(context, mesh, surface),
            sharing=build_program(context, mesh, compose("surface.frag", defines=shared)),
            static=build_program(
                context,
                compose("textured.vert", defines=static),
                compose("textured.frag", defines=static),
            ),
            unwrap=build_program(context, compose("unwrap.vert"), surface),
        )
        self.textured_program = build_program(
            context, compose("textured.vert"), compose("textured.frag")
        )
        self._background = self._screen("background.frag")
        self._enlarge = self._screen("enlarge.frag")
        self._near_edges = self._screen("near_edges.frag")
        self._smooth = self._screen("smooth_edges.frag")
        self.placeholder = upload_placeholder(context, self.mesh_programs)
        self._queries: list[moderngl.Query] = []

    def begin(self) -> None:
        """Set what passes rely on as GL has it at first, whatever somebody else has left (measured:
        3 microseconds)."""
        context = self._context
        context.enable_only(moderngl.NOTHING)
        context.front_face, context.cull_face, context.wireframe = "ccw", "back", False
        context.polygon_offset, context.depth_clamp_range = (0, 0), None
        context.depth_func = "<"
        context.clear_samplers(0, UNIT_STILL + 1)

    def draw_room(
        self, targets: RenderTargets, views: Sequence[tuple[Camera, PixelRect]], room: Room
    ) -> None:
        """Draw the room as each view sees it into the image that frames begin with."""
        program = self._background.program
        members: dict[str, Any] = {name: program[name] for name in program}
        seats = np.zeros((members["seats"].array_length, 4), np.float32)
        for row, place, speaking in zip(seats, room.seats_m, room.speaking, strict=False):
            row[:] = (*place, speaking)
        members["seats"].write(seats.tobytes())
        for camera, rect in views:
            # Right, up and forward of the camera are the columns.
            turned = np.array([[1.0], [-1.0], [1.0]]) * camera.rotation
            members["world_from_view"].write(turned.astype(np.float32).tobytes())
            set_values(
                program,
                lens=lens_of(camera),
                eye_m=tuple(camera.centre_m.tolist()),
                table_m=room.table_m,
                brightness=float(room.is_light),
                num_seats=min(len(room.seats_m), len(seats)),
                rect=(-1.0, -1.0, 1.0, 1.0),
            )
            targets.small_room.use()
            self._background.render(moderngl.TRIANGLE_STRIP, vertices=4)
            targets.room.use()
            targets.small_room_image.use(0)
            set_values(self._enlarge.program, rect=clip_rect(rect, targets.size))
            self._enlarge.render(moderngl.TRIANGLE_STRIP, vertices=4)

    def surfaces(
        self, targets: RenderTargets, heads: Sequence[DecodedHead], *, clear: bool
    ) -> None:
        """Keep, per pixel, what is nearest.

        Only depth is cleared, unless `clear`: where no mesh lies before the far plane nobody looks
        at the rest, and clearing 20 bytes a pixel takes as long as shading 50,000 (llvmpipe).
        """
        targets.depth.use()
        targets.depth.clear(depth=1.0)
        if clear:
            targets.surface.viewport = (0, 0, *targets.size)
            targets.surface.clear(depth=1.0)
        self._draw_meshes(targets, heads)

    def _draw_meshes(self, targets: RenderTargets, heads: Sequence[DecodedHead]) -> None:
        targets.surface.use()
        self._context.enable(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        # Near ones first: what they hide is tested away before it is written.
        for head in sorted(heads, key=lambda head: float(head.place.matrix[3, 3])):
            is_shared = head.share != WHOLE
            programs = self.mesh_programs
            program = programs.sharing if is_shared else programs.whole
            targets.surface.viewport = viewport(head.place.view)
            head.position.texture.use(UNIT_POSITION)
            set_matrix(program, "clip_from_head", head.place.matrix)
            set_values(
                program,
                slot=float(head.number),
                position_rows=(head.position.first_row, head.position.num_rows),
                shown=head.place.shown,
                low_m=head.body.low_m,
                high_m=head.body.high_m,
            )
            if is_shared:
                set_values(program, share=head.share)
            head.mesh.vertices[is_shared].render()

    def shade(
        self, targets: RenderTargets, heads: Sequence[DecodedHead], *, count: bool
    ) -> list[int | None]:
        """Colour the pixels of each head over the room, and say how many they were; None unless
        they are to be counted, which waits for the GPU."""
        context = self._context
        targets.shaded.use()
        context.copy_framebuffer(targets.shaded, targets.room)
        context.disable(moderngl.CULL_FACE)
        # Only where some mesh lies before the far plane: whole blocks of others are skipped before
        # any program runs.
        context.enable(moderngl.DEPTH_TEST)
        targets.textured.depth_mask = False
        targets.textured.viewport = (0, 0, *targets.size)
        targets.room_image.use(UNIT_ROOM)
        for unit, texture in targets.visible.items():
            texture.use(unit)
        counts = self._draw_each(heads, partial(self._shade_one, targets), count)
        targets.textured.use()
        targets.textured.depth_mask = True
        context.depth_func = "<"
        return counts

    def statics(
        self, targets: RenderTargets, heads: Sequence[DecodedHead], *, count: bool = False
    ) -> list[int | None]:
        """Draw what of decoded heads does not change over the shaded image, behind what is nearer;
        counts as `shade`."""
        program = self.mesh_programs.static
        targets.room_image.use(UNIT_ROOM)
        targets.textured.use()
        self._context.enable(moderngl.DEPTH_TEST | moderngl.CULL_FACE)

        def paint(head: DecodedHead) -> None:
            place, body, vertices = head.place, head.body, head.mesh.static
            if vertices is None or body.skin is None:
                return
            targets.textured.viewport = viewport(place.view)
            body.skin.use(UNIT_SKIN)
            set_matrix(program, "clip_from_head", place.matrix)
            set_values(
                program,
                slot=float(head.mark),
                shown=place.shown,
                low_m=body.low_m,
                high_m=body.high_m,
                share=head.share,
            )
            vertices.render()

        return self._draw_each(heads, paint, count)

    def texture(
        self,
        targets: RenderTargets,
        heads: Sequence[PaintedHead],
        *,
        count: bool = False,
    ) -> list[int | None]:
        """Draw textured heads over the shaded image, behind what is nearer; counts as `shade`, a
        pixel that is drawn over again."""
        if not heads:
            return []
        targets.room_image.use(UNIT_ROOM)
        targets.textured.use()
        self._context.enable(moderngl.DEPTH_TEST | moderngl.CULL_FACE)

        def paint(head: PaintedHead) -> None:
            place, mesh = head.place, head.mesh
            targets.textured.viewport = viewport(place.view)
            mesh.texture.use(UNIT_SKIN)
            set_matrix(self.textured_program, "clip_from_head", place.matrix)
            set_values(
                self.textured_program,
                slot=float(head.number),
                shown=place.shown,
                low_m=mesh.low_m,
                high_m=mesh.high_m,
            )
            mesh.vertices.render()

        return self._draw_each(heads, paint, count)

    def smooth(self, targets: RenderTargets, places: Sequence[Place]) -> None:
        """Copy the shaded image, and blur the stair-steps of silhouettes within these
        rectangles."""
        context, size = self._context, targets.size
        targets.smoothed.use()
        context.copy_framebuffer(targets.smoothed, targets.shaded)
        context.disable(moderngl.CULL_FACE)
        context.enable(moderngl.DEPTH_TEST)
        targets.shaded_image.use(0)
        set_values(self._smooth.program, texel=(1 / size[0], 1 / size[1]))
        targets.depth.use()
        targets.depth.clear(depth=0.0)
        for target, screen, depth_func in (
            (targets.depth, self._near_edges, "1"),
            (targets.marked, self._smooth, "=="),
        ):
            target.use()
            context.depth_func = depth_func
            for place in places:
                set_values(screen.program, rect=clip_rect(inset_rect(place.rect, size), size))
                screen.render(moderngl.TRIANGLE_STRIP, vertices=4)
        context.depth_func = "<"
        context.disable(moderngl.DEPTH_TEST)

    def _shade_one(self, targets: RenderTargets, head: DecodedHead) -> None:
        body = head.body
        body.bind()
        if head.expression is not None:
            codes = head.expression.texture
            codes.use(UNIT_EXPRESSION)
            rows = head.expression.first_row, head.expression.num_rows, codes.height
            is_change = codes.width < body.still_size
            set_values(body.shade.program, expression_rows=(*rows, is_change))
        targets.textured.use()
        self._context.depth_func = ">"
        set_values(
            body.shade.program,
            slot=float(head.number),
            mark=float(head.mark),
            shown=head.place.shown,
            rect=clip_rect(head.place.rect, targets.size),
        )
        body.shade.render(moderngl.TRIANGLE_STRIP, vertices=4)

    def _draw_each(
        self, heads: Sequence[T], draw: Callable[[T], None], count: bool
    ) -> list[int | None]:
        """Draw heads one after the other, and count what each colours if asked to."""
        while count and len(self._queries) < len(heads):
            self._queries.append(self._context.query(samples=True))
        for number, head in enumerate(heads):
            with self._queries[number] if count else nullcontext():
                draw(head)
        # Asked for at the end: each answer waits for what was drawn before it.
        queries = self._queries[: len(heads)] if count else []
        return [int(query.samples) for query in queries] or [None] * len(heads)

    def _screen(self, name: str) -> moderngl.VertexArray:
        """A rectangle of the screen, drawn by a program of its own."""
        program = build_program(self._context, compose("rect.vert"), compose(name))
        return self._context.vertex_array(program, [])


def viewport(rect: PixelRect) -> tuple[int, int, int, int]:
    """A rectangle as GL wants it: left, bottom, width, height."""
    left, bottom, right, top = rect
    return left, bottom, right - left, top - bottom


def clip_rect(rect: PixelRect, size: tuple[int, int]) -> tuple[float, float, float, float]:
    """A rectangle of pixels in clip space."""
    left, bottom, right, top = rect
    return (
        2 * left / size[0] - 1,
        2 * bottom / size[1] - 1,
        2 * right / size[0] - 1,
        2 * top / size[1] - 1,
    )


def rect_in_view(clip: tuple[float, float, float, float], view: PixelRect) -> PixelRect:
    """The whole pixels of a view that touch a rectangle of its clip space."""
    left, bottom, width, height = viewport(view)
    return (
        left + math.floor((clip[0] + 1) / 2 * width),
        bottom + math.floor((clip[1] + 1) / 2 * height),
        left + math.ceil((clip[2] + 1) / 2 * width),
        bottom + math.ceil((clip[3] + 1) / 2 * height),
    )


def inset_rect(rect: PixelRect, size: tuple[int, int]) -> PixelRect:
    """The part of a rectangle, grown by a pixel, that keeps a pixel's distance from the image's
    border."""
    left, bottom, right, top = rect
    return (
        max(left - 1, 1),
        max(bottom - 1, 1),
        max(min(right + 1, size[0] - 1), 1),
        max(min(top + 1, size[1] - 1), 1),
    )
