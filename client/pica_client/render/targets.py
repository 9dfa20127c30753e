"""The images that a frame of one size passes through."""

import math

import moderngl

from pica_client.render.gpu_program import UNIT_VISIBLE_UV, UNIT_VISIBLE_XYZ, clamp

PixelRect = tuple[int, int, int, int]
"""Left, bottom, right, top in pixels of the whole image, rows counted from the bottom as GL
does."""

SMALL_ROOM = (224, 160)
"""Columns and rows that the room is drawn in before it is enlarged, whatever the picture's size: a
view that turns draws it in every frame (llvmpipe, 1280 x 720, five seats: 22 ms at full size)."""


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
        final_image = context.texture(size, 4)
        self.final = context.framebuffer([final_image])
        self.marked = context.framebuffer([final_image], depth)
        """The final image with the depth of the surface pass, which by then marks edges."""
        self.room_image = context.texture(size, 4)
        self.room = context.framebuffer([self.room_image])
        self.small_room_image = clamp(context.texture(SMALL_ROOM, 4, dtype="f2"))
        self.small_room = context.framebuffer([self.small_room_image])
        """What a view of the room is enlarged from."""


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
