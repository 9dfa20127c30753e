"""The passes of a frame: the programs they use, and the order of GL calls."""

import math
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from typing import Any

import moderngl
import numpy as np

from pica_client.render.draw_list import ShownHead
from pica_client.render.gpu_avatar import MeshPrograms
from pica_client.render.gpu_plain import upload_placeholder
from pica_client.render.gpu_program import (
    UNIT_EXPRESSION,
    UNIT_LAYER,
    UNIT_POSITION,
    UNIT_ROOM,
    UNIT_SKIN,
    UNIT_STILL,
    build_program,
    compose,
    set_values,
)
from pica_client.render.layers import (
    Images,
    Layer,
    PixelRect,
    area_px,
    clip_rect,
    viewport,
)
from pica_client.render.room import Room, lens_of
from pica_core.camera import Camera
from pica_core.gl import is_software

LayeredHead = tuple[ShownHead, Layer]
"""A head and the layer that it is drawn into."""
EDGE_STEP, NO_STEP = 0.25, 2.0
"""Where a neighbour has so much more or less of the head, there is an edge: a bust fades more
slowly."""


class DrawPasses:
    """All programs that no avatar brings along, and the passes that use them.

    Raises:
        ShaderError: The driver refuses our shaders.
    """

    def __init__(self, context: moderngl.Context, *, smooth_edges: bool) -> None:
        self._context, self._is_smooth = context, smooth_edges
        self._is_software = is_software(str(context.info["GL_RENDERER"]))
        mesh, surface = compose("mesh.vert", defines={"MAPPED": ""}), compose("surface.frag")
        self.mesh_programs = MeshPrograms(
            surface=build_program(context, mesh, surface),
            static=build_program(context, compose("mesh.vert"), compose("textured.frag")),
            unwrap=build_program(context, compose("unwrap.vert"), surface),
        )
        self._background = self._screen("background.frag")
        self._enlarge = self._screen("enlarge.frag")
        self._finish = self._screen("finish_head.frag")
        self._finish_fading = self._screen("finish_head.frag", {"FADING": ""})
        for screen in (self._finish, self._finish_fading):
            set_values(screen.program, step=EDGE_STEP if smooth_edges else NO_STEP)
        self._place = self._screen("place_head.frag", {"FILLED": ""})
        self.placeholder = upload_placeholder(context, self.mesh_programs.static)
        self._queries: list[moderngl.Query] = []

    def begin(self) -> None:
        """Set what passes rely on as GL has it at first, whatever other code has left (measured:
        3 microseconds)."""
        context = self._context
        context.enable_only(moderngl.NOTHING)
        context.front_face, context.cull_face, context.wireframe = "ccw", "back", False
        context.polygon_offset, context.depth_clamp_range = (0, 0), None
        context.depth_func = "<"
        context.clear_samplers(0, UNIT_STILL + 1)

    def draw_room(
        self,
        images: Images,
        views: Sequence[tuple[Camera, PixelRect]],
        room: Room,
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
                num_seats=min(len(room.seats_m), len(seats)),
            )
            images.small_room.use()
            self._background.render(moderngl.TRIANGLE_STRIP, vertices=4)
            images.room.use()
            images.small_room_image.use(0)
            set_values(self._enlarge.program, rect=clip_rect(rect, images.size))
            self._enlarge.render(moderngl.TRIANGLE_STRIP, vertices=4)

    def surfaces(self, heads: Sequence[LayeredHead]) -> None:
        """Keep, per pixel of each layer, what of its head is nearest.

        Where no mesh lies before the far plane only depth is read. So only depth is cleared where
        clearing 20 bytes a pixel takes as long as shading 50,000 (llvmpipe); elsewhere to bind one
        framebuffer more takes longer.
        """
        self._context.enable(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        for head, layer in heads:
            empty = layer.empty if self._is_software else layer.surface
            empty.use()
            empty.clear(depth=1.0)
            layer.surface.use()
            if head.mesh.decoded is not None and head.position is not None:
                head.position.use(UNIT_POSITION)
                self._set_head(self.mesh_programs.surface, head, layer)
                head.mesh.decoded.render()

    def colour(self, heads: Sequence[LayeredHead], *, count: bool) -> tuple[int, int] | None:
        """Colour the layers of heads after their surfaces: decode their pixels, draw what has a
        texture.

        Returns:
            The decoded and the textured pixels, one that is drawn over again twice; None unless
            they are to be counted, which waits for the GPU.
        """
        while count and len(self._queries) < 2 * len(heads):
            self._queries.append(self._context.query(samples=True))
        queries = iter(self._queries)
        for head, layer in heads:
            for draw in (self._decode, self._texture):
                with next(queries) if count else nullcontext():
                    draw(head, layer)
        self._context.depth_func = "<"
        # Asked for at the end: each answer waits for what was drawn before it.
        answers = [query.samples for query in self._queries[: 2 * len(heads)]] if count else []
        return (sum(answers[::2]), sum(answers[1::2])) if count else None

    def _decode(self, head: ShownHead, layer: Layer) -> None:
        """Run the pixel decoder where the surface pass has found something."""
        body = head.body
        layer.coloured.depth_mask = False
        layer.coloured.use()
        layer.coloured.clear()
        if body.shade is None or head.expression is None:
            return
        body.bind()
        head.expression.use(UNIT_EXPRESSION)
        set_values(body.shade.program, is_change=head.expression.width < body.still_size)
        for unit, texture in layer.visible.items():
            texture.use(unit)
        # Only where some mesh lies before the far plane: whole blocks of others are skipped before
        # any program runs.
        self._context.depth_func = ">"
        self._context.disable(moderngl.CULL_FACE)
        set_values(body.shade.program, shown=body.fade_m)
        body.shade.render(moderngl.TRIANGLE_STRIP, vertices=4)

    def _texture(self, head: ShownHead, layer: Layer) -> None:
        """Draw what has a texture, behind what is nearer; the framebuffer is that of `_decode`."""
        body, static, program = head.body, head.mesh.static, self.mesh_programs.static
        if static is None or body.skin is None:
            return
        set_values(program, corner=head.rect[:2])
        self._context.depth_func, layer.coloured.depth_mask = "<", True
        self._context.enable(moderngl.CULL_FACE)
        body.skin.use(UNIT_SKIN)
        self._set_head(program, head, layer)
        set_values(program, shown=body.fade_m)
        static.render()

    def _set_head(self, program: moderngl.Program, head: ShownHead, layer: Layer) -> None:
        member: Any = program["clip_from_head"]
        member.write(layer.clip_from_head)
        set_values(program, box_m=(head.body.low_m, head.body.high_m))

    def finish(self, images: Images, heads: Sequence[LayeredHead]) -> None:
        """Copy layers as they are laid over the room: without the stair-steps of silhouettes, and
        faded where a bust fades."""
        self._context.disable(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        images.room_image.use(UNIT_ROOM)
        for head, layer in heads:
            if not (self._is_smooth or head.fades):
                continue
            layer.finished.use()
            layer.colour.use(UNIT_LAYER)
            width, height = layer.size
            (left, bottom, _, _), highest = head.rect, math.ceil(max(head.fading_rows))
            # All of it is there from here on; a GPU gains less by it than one more draw costs.
            is_split = self._is_software and head.opacity == 1
            split = math.ceil(layer.scale * (highest - bottom)) if is_split else height
            split = min(max(split, 0), height) if head.fades else 0
            fading, whole = (0, 0, width, split), (0, split, width, height)
            for screen, part in ((self._finish_fading, fading), (self._finish, whole)):
                if not area_px(part):
                    continue
                if screen is self._finish_fading:
                    set_values(
                        screen.program,
                        corner=(left, bottom, layer.scale),
                        opacity=head.opacity,
                        fading=head.fading_rows,
                    )
                layer.finished.scissor = viewport(part)
                screen.render(moderngl.TRIANGLE_STRIP, vertices=4)
            layer.finished.scissor = None  # type: ignore[assignment]

    def place(self, images: Images, heads: Sequence[LayeredHead]) -> None:
        """Put the image together: the room, and over it all heads, the farthest first."""
        context, image, program = self._context, images.final, self._place.program
        context.copy_framebuffer(image, images.room)
        context.enable_only(moderngl.BLEND)
        context.blend_func = moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA
        context.blend_equation = moderngl.FUNC_ADD  # type: ignore[assignment]
        image.use()
        for head, layer in heads:
            (layer.shown if self._is_smooth or head.fades else layer.colour).use(UNIT_LAYER)
            sides = zip(viewport(head.rect)[2:], layer.size, strict=True)
            filled = tuple(layer.scale * side / own for side, own in sides)
            set_values(program, rect=clip_rect(head.rect, images.size), filled=filled)
            self._place.render(moderngl.TRIANGLE_STRIP, vertices=4)
        context.disable(moderngl.BLEND)

    def _screen(self, name: str, defines: Mapping[str, str] | None = None) -> moderngl.VertexArray:
        """A rectangle of the screen, drawn by a program of its own."""
        vertex, fragment = (compose(each, defines=defines or {}) for each in ("rect.vert", name))
        program = build_program(self._context, vertex, fragment)
        return self._context.vertex_array(program, [])
