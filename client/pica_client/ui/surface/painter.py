"""What a `Surface` has set, drawn by moderngl into any framebuffer.

ImGui's textures (its glyphs, which come as they are needed) are kept here; `show` and `adopt` add
pictures of ours. One painter for each surface, on the thread of the GL context.
"""

import ctypes
from collections.abc import Sequence

import moderngl
import numpy as np
from imgui_bundle import imgui

from pica_client.render.shader_source import compose
from pica_client.ui.surface.surface import BACKGROUND, PLAIN, Surface
from pica_core.gl import link_program
from pica_core.types import Image

FIRST_BUFFER_BYTES = 1 << 16
Region = tuple[int, int, int, int]
"""Left, bottom, width and height within a framebuffer, pixels."""


class Painter:
    """Draws one surface.

    Args:
        context: GL 3.3, current on this thread.
    """

    def __init__(self, context: moderngl.Context, surface: Surface) -> None:
        self._context = context
        self._surface = surface
        self._programs = [
            link_program(
                context,
                vertex=compose("shapes.vert", defines=kind).text,
                fragment=compose("shapes.frag", defines=kind).text,
            )
            for kind in ({}, {"PLAIN": ""})
        ]
        self._textures: dict[int, moderngl.Texture] = {}
        self._adopted: dict[str, moderngl.Texture] = {}
        self._vertices = context.buffer(reserve=FIRST_BUFFER_BYTES, dynamic=True)
        self._indices = context.buffer(reserve=FIRST_BUFFER_BYTES, dynamic=True)
        # The same corners and triangles for both programs.
        layouts = (("2f 2f 4f1", "place", "uv", "colour"), ("2f 8x 4f1", "place", "colour"))
        self._shapes, self._areas = (
            context.vertex_array(program, [(self._vertices, *layout)], index_buffer=self._indices)
            for program, layout in zip(self._programs, layouts, strict=True)
        )

    def show(self, name: str, image: Image) -> int:
        """A picture to show in a panel, uint8 ``[H, W, 3]``; see `adopt`."""
        size = (image.shape[1], image.shape[0])
        texture = self._adopted.get(name)
        if texture is None or texture.size != size:
            texture = self._context.texture(size, 3, alignment=1)
        texture.write(np.ascontiguousarray(image), alignment=1)
        return self.adopt(name, texture)

    def adopt(self, name: str, texture: moderngl.Texture) -> int:
        """A texture to show in a panel, until another one is of that name; gives its number, which
        is for `ImTextureRef`."""
        before = self._adopted.get(name, texture)
        if before.glo != texture.glo:
            self._textures.pop(before.glo, None)
        self._adopted[name] = self._textures[texture.glo] = texture
        return int(texture.glo)

    def paint(
        self,
        target: moderngl.Framebuffer,
        region: Region | None = None,
        *,
        background: bool = True,
        windows: bool = True,
    ) -> None:
        """Blend the last frame over a framebuffer.

        Args:
            region: The part of it that shows the surface; by default all.
            windows: Draw what stands before it.
        """
        data = self._surface.draw_data()
        self._update_textures(data)
        context = self._context
        left, bottom, width, height = region or (0, 0, *target.size)
        columns, rows = data.display_size
        target.use()
        context.viewport = (left, bottom, width, height)
        context.enable_only(moderngl.BLEND)
        context.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA
        for program in self._programs:
            program["size"] = (columns, rows)
        lists = [
            shapes
            for shapes in data.cmd_lists
            if (background if shapes._owner_name == BACKGROUND else windows)
        ]
        self._write(lists)
        first = 0
        for shapes in lists:
            self._paint_list(shapes, first, (left, bottom, rows))
            first += shapes.idx_buffer.size()
        context.scissor = None
        context.disable(moderngl.BLEND)
        context.viewport = (0, 0, *target.size)

    def _paint_list(
        self, shapes: imgui.ImDrawList, first: int, place: tuple[int, int, float]
    ) -> None:
        left, bottom, rows = place
        for command in shapes.cmd_buffer:
            low_x, low_y, high_x, high_y = command.clip_rect
            from_x, from_y = max(int(low_x), 0), max(int(low_y), 0)
            width, height = int(high_x) - from_x, int(high_y) - from_y
            if width <= 0 or height <= 0:
                continue
            self._context.scissor = (
                left + from_x,
                bottom + max(int(rows - high_y), 0),
                width,
                height,
            )
            part = {"vertices": command.elem_count, "first": first + command.idx_offset}
            number = command.tex_ref.get_tex_id()
            if number == PLAIN:
                self._context.disable(moderngl.BLEND)
                self._areas.render(moderngl.TRIANGLES, **part)
                self._context.enable(moderngl.BLEND)
            else:
                self._textures[number].use(0)
                self._shapes.render(moderngl.TRIANGLES, **part)

    def _write(self, lists: Sequence[imgui.ImDrawList]) -> None:
        """Bring lists to the GPU, one behind the other; buffers grow by doubling."""
        vertices: list[bytes] = []
        indices: list[bytes] = []
        base = 0
        for shapes in lists:
            corners, order = shapes.vtx_buffer, shapes.idx_buffer
            size_bytes = corners.size() * imgui.VERTEX_SIZE
            vertices.append(ctypes.string_at(corners.data_address(), size_bytes))
            raw = ctypes.string_at(order.data_address(), order.size() * imgui.INDEX_SIZE)
            own = np.frombuffer(raw, f"u{imgui.INDEX_SIZE}").astype(np.uint32)
            indices.append((own + np.uint32(base)).tobytes())
            base += corners.size()
        for buffer, parts in ((self._vertices, vertices), (self._indices, indices)):
            content = b"".join(parts)
            is_too_small = len(content) > buffer.size
            buffer.orphan(max(len(content), 2 * buffer.size) if is_too_small else -1)
            buffer.write(content)

    def _update_textures(self, data: imgui.ImDrawData) -> None:
        """Do to our textures what ImGui wants done to its own."""
        for wanted in data.textures:
            if wanted.status == imgui.ImTextureStatus.want_create:
                size = (wanted.width, wanted.height)
                texture = self._context.texture(size, 4, wanted.get_pixels_array().tobytes())
                # Glyphs stand on whole pixels, and software GL is faster without averaging.
                texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
                texture.repeat_x = texture.repeat_y = False
                self._textures[texture.glo] = texture
                wanted.set_tex_id(texture.glo)
            elif wanted.status == imgui.ImTextureStatus.want_updates:
                texture = self._textures[wanted.tex_id]
                pixels = wanted.get_pixels_array().reshape(wanted.height, wanted.width, 4)
                for part in wanted.updates:
                    x, y, width, height = part.x, part.y, part.w, part.h
                    patch = np.ascontiguousarray(pixels[y : y + height, x : x + width])
                    texture.write(patch, viewport=(x, y, width, height))
            elif wanted.status == imgui.ImTextureStatus.want_destroy:
                self._textures.pop(wanted.tex_id, None)
                wanted.set_tex_id(0)
                wanted.set_status(imgui.ImTextureStatus.destroyed)
                continue
            else:
                continue
            wanted.set_status(imgui.ImTextureStatus.ok)
