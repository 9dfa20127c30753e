"""Texts on top of the picture, set by `ui.text_raster`, drawn as textures.

An item is set again only when its text or size changes; a texture whose key is not drawn any more
is given back.

    items = [OverlayItem(key="name:peer-1", lines=(("Ada", ""),), x_px=480, y_px=420)]
    renderer.draw(placements, camera, items)
"""

from collections.abc import Sequence
from typing import Any

import moderngl

from pica_client.render.shader_source import compose
from pica_client.ui.text_raster import OverlayItem, corner_px, set_item
from pica_core.gl import link_program

__all__ = ["Overlay", "OverlayItem"]


class Overlay:
    """Keeps the textures of the items drawn last."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._program = link_program(
            context, vertex=compose("rect.vert").text, fragment=compose("overlay.frag").text
        )
        self._rect = context.vertex_array(self._program, [])
        self._textures: dict[str, tuple[Any, moderngl.Texture]] = {}

    def draw(self, items: Sequence[OverlayItem], size: tuple[int, int]) -> None:
        """Blend items over the framebuffer in use, in this order."""
        context, (width, height) = self._context, size
        current = {item.key for item in items}
        for key in [key for key in self._textures if key not in current]:
            del self._textures[key]
        if not items:
            return
        context.enable(moderngl.BLEND)
        context.blend_func = moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA
        member: Any = self._program["rect"]
        for item in items:
            texture = self._texture(item)
            left, top = corner_px(item, texture.size, size)
            member.value = (
                2 * left / width - 1,
                1 - 2 * (top + texture.height) / height,
                2 * (left + texture.width) / width - 1,
                1 - 2 * top / height,
            )
            texture.use(0)
            self._rect.render(moderngl.TRIANGLE_STRIP, vertices=4)
        context.disable(moderngl.BLEND)

    def _texture(self, item: OverlayItem) -> moderngl.Texture:
        content = item.content
        known = self._textures.get(item.key)
        if known is not None and known[0] == content:
            return known[1]
        image = set_item(item)
        size = (image.shape[1], image.shape[0])
        if known is not None and known[1].size == size:
            texture = known[1]
            texture.write(image)
        else:
            texture = self._context.texture(size, 4, image.tobytes())
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._textures[item.key] = (content, texture)
        return texture
