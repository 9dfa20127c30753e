"""Texts on top of the picture: names, a statistics panel, help. Set by Pillow, drawn as textures.

An item is set again only when its text or size changes; a texture whose key is not drawn any more
is given back.

    items = [OverlayItem(key="name:peer-1", lines=(("Ada", ""),), x_px=480, y_px=420,
    style="label")] renderer.draw(placements, camera, items)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import moderngl
import numpy as np
import numpy.typing as npt
from PIL import Image as PillowImage
from PIL import ImageDraw, ImageFont

from pica_client.shader_source import compose
from pica_core.gl import link_program

Style = Literal["label", "panel"]

MAX_LINES = 40
MAX_CHARACTERS = 120
"""Per text; longer ones are cut, so no name can fill the screen or the memory."""
FALLBACK_FONT = "DejaVuSans.ttf"
"""For names beyond Latin script, where the machine has it; Pillow's own font is Latin."""

_INK = (240, 242, 245)
_FAINT = (165, 174, 186)
_PLATE = (16, 19, 24)


@dataclass(frozen=True, kw_only=True, slots=True)
class OverlayItem:
    """One text on the screen."""

    key: str
    """Identifies its texture from frame to frame."""
    lines: tuple[tuple[str, str], ...]
    """Left and right part of each line: two columns of a panel, plain and faint text of a label."""
    x_px: float
    y_px: float
    """Anchor in image pixels, y down: the upper left corner of a panel, the middle of a label's
    upper edge."""
    style: Style = "label"
    is_right_aligned: bool = False
    """A panel's anchor is its upper right corner."""
    size_px: int = 16
    """Height of the type."""


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
            share = 0.5 if item.style == "label" else float(item.is_right_aligned)
            left = round(item.x_px - share * texture.width)
            top = round(item.y_px)
            left = min(max(left, 0), max(width - texture.width, 0))
            top = min(max(top, 0), max(height - texture.height, 0))
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
        content = (item.lines, item.style, item.size_px)
        known = self._textures.get(item.key)
        if known is not None and known[0] == content:
            return known[1]
        image = set_text(item.lines, item.style, item.size_px)
        size = (image.shape[1], image.shape[0])
        if known is not None and known[1].size == size:
            texture = known[1]
            texture.write(image)
        else:
            texture = self._context.texture(size, 4, image.tobytes())
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._textures[item.key] = (content, texture)
        return texture


def set_text(lines: Sequence[tuple[str, str]], style: Style, size_px: int) -> npt.NDArray[np.uint8]:
    """Set lines on a rounded plate: a panel in two columns, a label centred with fainter right
    parts.

    Returns:
        Premultiplied RGBA, uint8 ``[H, W, 4]``.
    """
    rows = [(_printable(left), _printable(right)) for left, right in lines[:MAX_LINES]]
    is_panel = style == "panel"
    small_px = size_px if is_panel else round(0.82 * size_px)
    fonts = [(_font(left, size_px), _font(right, small_px)) for left, right in rows]
    widths = [
        left_font.getlength(left) + right_font.getlength(right)
        for (left, right), (left_font, right_font) in zip(rows, fonts, strict=True)
    ]
    inner = max(widths, default=0.0)
    pad_x, pad_y = round(0.65 * size_px), round(0.34 * size_px)
    leading = round(1.25 * size_px)
    if is_panel:
        pad_x, pad_y = round(0.9 * size_px), round(0.75 * size_px)
        leading = round(1.42 * size_px)
        # In steps of the type's height: a number that gains a digit does not resize the texture.
        inner = math.ceil((inner + 1.6 * size_px) / size_px) * size_px
    width, height = math.ceil(inner) + 2 * pad_x, leading * len(rows) + 2 * pad_y
    image = PillowImage.new("RGB", (width, height), _PLATE)
    alpha = _plate(width, height, 0.7 * size_px, 205 if is_panel else 150)
    draw, opaque = ImageDraw.Draw(image), ImageDraw.Draw(alpha)
    for index, ((left, right), (left_font, right_font)) in enumerate(zip(rows, fonts, strict=True)):
        middle = pad_y + leading * (index + 0.5)
        parts: list[tuple[str, Any, float, str, tuple[int, int, int]]]
        if is_panel:
            parts = [
                (left, left_font, pad_x, "lm", _FAINT if right else _INK),
                (right, right_font, width - pad_x, "rm", _INK),
            ]
        else:
            parts = [
                (left, left_font, width / 2, "mm", _INK),
                (right, right_font, width / 2, "mm", _FAINT),
            ]
        for text, font, x, anchor, ink in parts:
            draw.text((x, middle), text, ink, font, anchor)
            opaque.text((x, middle), text, 255, font, anchor)
    rgb, a = np.asarray(image, np.uint16), np.asarray(alpha, np.uint16)[..., None]
    premultiplied = np.concatenate([(rgb * a + 127) // 255, a], axis=-1)
    return np.ascontiguousarray(premultiplied, np.uint8)


def _plate(width: int, height: int, radius: float, opacity: int) -> PillowImage.Image:
    """A rounded rectangle as an alpha image; drawn large and reduced, for Pillow does not
    smooth."""
    scale = 4
    large = PillowImage.new("L", (width * scale, height * scale), 0)
    corners = (0, 0, width * scale - 1, height * scale - 1)
    ImageDraw.Draw(large).rounded_rectangle(corners, radius * scale, fill=opacity)
    return large.resize((width, height), PillowImage.Resampling.LANCZOS)


def _printable(text: str) -> str:
    shown = "".join(char if char.isprintable() else " " for char in text)
    return shown if len(shown) <= MAX_CHARACTERS else shown[: MAX_CHARACTERS - 1] + "…"


def _font(text: str, size_px: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    is_latin = all(ord(char) < 0x250 or char in "–—…·×" for char in text)
    return _load_font(is_latin, size_px)


@lru_cache(maxsize=32)
def _load_font(is_latin: bool, size_px: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    if not is_latin:
        try:
            return ImageFont.truetype(FALLBACK_FONT, size_px)
        except OSError:
            pass  # the machine has no such font: boxes instead of letters, but a name all the same
    return ImageFont.load_default(size_px)
