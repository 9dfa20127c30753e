"""Where heads are drawn: each into a layer of its own, which is kept, and all layers into an image.

A camera on a desk stands still and most people in a call listen, so most heads look as they did an
image before. Such a head keeps its layer: its colours, and how much of them is there. An image is
the room with all layers over it, the farthest head first.
"""

from collections.abc import Hashable

import moderngl
import numpy as np

from pica_client.render.gpu_program import UNIT_VISIBLE_UV, UNIT_VISIBLE_XYZ, clamp
from pica_core.types import Array

PixelRect = tuple[int, int, int, int]
"""Left, bottom, right, top in pixels of the whole image, rows counted from the bottom as GL
does."""

SIDE_STEP_PX = 32
"""Sides of layers are multiples of this, so that a head that sways keeps its layer."""
SMALL_ROOM = (224, 160)
"""Columns and rows that the room is drawn in before it is enlarged, whatever the picture's size: a
view that turns draws it in every frame (llvmpipe, 1280 x 720, five seats: 22 ms at full size)."""


class Layer:
    """One head as one view sees it; its lower left corner is that of the head's rectangle.

    Args:
        scale: Its pixels for each of the image.

    Attributes:
        look: All that what was drawn last depends on.
        finish: All that `shown` depends on.
        clip_from_head: The matrix that it is drawn with, 16 float32, column by column.
    """

    def __init__(self, context: moderngl.Context, size: tuple[int, int], scale: float) -> None:
        self.size, self.scale = size, scale
        self.visible = {
            UNIT_VISIBLE_XYZ: context.texture(size, 4, dtype="f4"),
            # 16 bits a coordinate: 1/7 of an entry of a table of 10,000, while a pixel of a head
            # that fills the screen reaches over six; writing 32 bits takes half as long again
            # (llvmpipe).
            UNIT_VISIBLE_UV: context.texture(size, 2, dtype="nu2"),
        }
        """What the surface pass writes, keyed by texture unit."""
        self.colour, self.depth = context.texture(size, 4), context.depth_texture(size)
        """Colours times how much of them is there, and that; depths, where 1 is nothing."""
        self.shown = context.texture(size, 4)
        """The same colours as they are laid over the room; last, how much of the rest they hide."""
        for texture in (*self.visible.values(), self.colour):
            clamp(texture, moderngl.NEAREST)
        clamp(self.shown, moderngl.NEAREST if scale == 1 else moderngl.LINEAR)
        self.empty = context.framebuffer([], self.depth)
        self.surface = context.framebuffer(list(self.visible.values()), self.depth)
        self.coloured = context.framebuffer([self.colour], self.depth)
        self.finished = context.framebuffer([self.shown])
        self.look: Hashable = None
        self.finish: Hashable = None
        self.clip_from_head = b""

    def read(self, texture: moderngl.Texture) -> Array:
        """What one of its textures holds, ``[rows, columns, channels]``, the lowest row first."""
        kind = np.dtype(f"<{texture.dtype.removeprefix('n')}")
        return np.frombuffer(texture.read(), kind).reshape(*self.size[::-1], -1)

    def serves(self, size: tuple[int, int], scale: float) -> bool:
        """Return True if a head of so many columns and rows fits, and does not leave most empty."""
        fits = all(
            side <= own <= side + 2 * SIDE_STEP_PX
            for side, own in zip(size, self.size, strict=True)
        )
        return scale == self.scale and (fits or self.size == layer_size(size))


def layer_size(size: tuple[int, int]) -> tuple[int, int]:
    """The columns and rows of a layer for a head of this size."""
    width, height = (-(-side // SIDE_STEP_PX) * SIDE_STEP_PX for side in size)
    return width, height


class Images:
    """What an image of one size, columns and rows, is put together in."""

    def __init__(self, context: moderngl.Context, size: tuple[int, int]) -> None:
        self.size = size
        self.final = context.framebuffer([context.texture(size, 4)])
        """What the renderer hands out: others may draw over it, so nothing is kept in it."""
        self.room_image = clamp(context.texture(size, 4), moderngl.NEAREST)
        self.room = context.framebuffer([self.room_image])
        self.small_room_image = clamp(context.texture(SMALL_ROOM, 4, dtype="f2"))
        self.small_room = context.framebuffer([self.small_room_image])
        """What a view of the room is enlarged from."""


def common_part(first: PixelRect, second: PixelRect) -> PixelRect:
    """What two rectangles share; empty where left is not below right, or bottom below top."""
    (left, bottom, right, top), other = first, second
    return max(left, other[0]), max(bottom, other[1]), min(right, other[2]), min(top, other[3])


def area_px(rect: PixelRect) -> int:
    """The pixels of a rectangle, 0 of an empty one."""
    left, bottom, right, top = rect
    return max(right - left, 0) * max(top - bottom, 0)


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
