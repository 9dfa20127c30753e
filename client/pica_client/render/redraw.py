"""Which parts of an image have to be drawn again: pure, no GPU.

A camera on a desk stands still and most people in a call listen, so most of an image is as it was.
A head's key holds everything that its pixels depend on. Where a key differs from that of the last
image, the rectangles of the head then and now are drawn again, with whoever reaches into them; all
other pixels stay. The image is the same, bit for bit, as one that is drawn as a whole.
"""

from collections.abc import Hashable, Sequence
from typing import NamedTuple

PixelRect = tuple[int, int, int, int]
"""Left, bottom, right, top in pixels of the whole image, rows counted from the bottom as GL
does."""

MARGIN_PX = 6
"""Smoothing of edges looks so far beyond the pixel that it colours (smooth_edges.frag: half its
reach, and two pixels)."""


class HeadKey(NamedTuple):
    """One head as it was drawn."""

    identity: Hashable
    """Slot and mark: a head with others is another head."""
    look: Hashable
    """All else that its pixels depend on."""
    rect: PixelRect
    """The part of the image that it may cover."""


def parts_to_draw(
    before: Sequence[HeadKey] | None, now: Sequence[HeadKey], size: tuple[int, int]
) -> list[PixelRect]:
    """The rectangles that differ from the image before, apart from each other; the whole image
    where nothing is known of that one, or other heads are drawn."""
    whole = (0, 0, *size)
    if before is None or [key.identity for key in before] != [key.identity for key in now]:
        return [whole]
    parts: list[PixelRect] = []
    for old, new in zip(before, now, strict=True):
        if old != new:
            left, bottom, right, top = around(old.rect, new.rect)
            grown = (left - MARGIN_PX, bottom - MARGIN_PX, right + MARGIN_PX, top + MARGIN_PX)
            parts = _with(parts, common_part(grown, whole))
    return parts


def around(first: PixelRect, second: PixelRect) -> PixelRect:
    """The least rectangle that holds two."""
    (left, bottom, right, top), other = first, second
    return min(left, other[0]), min(bottom, other[1]), max(right, other[2]), max(top, other[3])


def common_part(first: PixelRect, second: PixelRect) -> PixelRect:
    """What two rectangles share; empty where left is not below right, or bottom below top."""
    (left, bottom, right, top), other = first, second
    return max(left, other[0]), max(bottom, other[1]), min(right, other[2]), min(top, other[3])


def area_px(rect: PixelRect) -> int:
    """The pixels of a rectangle, 0 of an empty one."""
    left, bottom, right, top = rect
    return max(right - left, 0) * max(top - bottom, 0)


def _with(parts: list[PixelRect], part: PixelRect) -> list[PixelRect]:
    """Parts with one more; those that overlap become one, so that no pixel is drawn twice."""
    apart = []
    for other in parts:
        if area_px(common_part(part, other)):
            part = around(part, other)
        else:
            apart.append(other)
    grew = len(apart) < len(parts)
    return _with(apart, part) if grew else [*apart, part]
