"""How much of each head can be seen: on the screen, not cut away, not behind others. Pure.

A head is taken for the ellipsoid in its bounding box. Its outline on the screen is an ellipse that
follows from the camera matrix alone: with the ellipsoid's dual quadric Q, the dual conic of the
outline is P Q P^T (Hartley and Zisserman, "Multiple View Geometry", 8.3). Points spread evenly over
that ellipse tell which part of it lies on the screen, and which part nearer heads hide.

Where it ends: an ellipsoid is no head, its outline covers some tenths more or less than the drawn
pixels. One that reaches through the near plane has no outline: it counts as filling the screen, and
hides no head, for we look through it. Hiders are taken a little smaller than they are, so that a
head of which an edge is seen is not given up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pica_client.render.scene import NEAR_M
from pica_core.types import Float64Array, FloatArray

NUM_POINTS = 64
"""Looked at per head: a hidden share is known to a few hundredths (chosen)."""
HIDER_SIZE = 0.9
"""Diameter of a hider over that of its ellipse (chosen: a head fills its box's ellipse less than
whole at chin and neck)."""
HIDDEN_RATIO = 0.98
"""A head of which this share is hidden cannot be seen: one point of the 64 may be missed."""
LEAST_PX = 0.25
"""Heads that cover less than this cannot be seen (chosen: a quarter of a pixel is antialiased
away)."""


class PlacedHead(NamedTuple):
    """One head before one camera."""

    clip_from_head: FloatArray
    """``[4, 4]`` for column vectors; its last row gives metres of depth, as
    `Camera.clip_from_world` does."""
    low_m: Sequence[float]
    """Lower corner of the box around the head, head frame."""
    high_m: Sequence[float]
    """Upper corner of the box."""


class Sight(NamedTuple):
    """What can be seen of one head. Pixels are those of the drawn image."""

    is_visible: bool
    visible_px: float = 0.0
    """Pixels on the screen that nearer heads do not hide, summed over the eyes."""
    head_px: float = 0.0
    """Height of the whole head on the screen, also of what lies outside; at most that of the screen
    for one that reaches through the near plane."""
    hidden_ratio: float = 0.0
    """Share of what is on the screen that nearer heads hide."""
    num_views: int = 0
    """Eyes that see it."""


NOTHING = Sight(is_visible=False)


def look(heads: Sequence[PlacedHead], size_px: tuple[int, int]) -> list[Sight]:
    """What can be seen of each head through one camera, whose image has so many columns and rows. A
    head whose matrix or box is not finite cannot be seen."""
    width, height = size_px
    outlines = [_outline(head) for head in heads]
    whole = [each for each in outlines if each is not None and each.depth - each.reach > NEAR_M]
    sights = []
    for outline in outlines:
        if outline is None or outline.depth + outline.reach <= NEAR_M:
            sights.append(NOTHING)
        elif outline.depth - outline.reach > NEAR_M:
            nearer = [other for other in whole if other.depth < outline.depth]
            sights.append(_sight(outline, nearer, size_px))
        else:
            sights.append(Sight(True, float(width * height), float(height), num_views=1))
    return sights


def merge_eyes(eyes: Sequence[Sequence[Sight]]) -> list[Sight]:
    """What several cameras see of the same heads together: of each the most that one of them sees.

    It is decoded once, but drawn by every eye that sees it: `visible_px` and `num_views` are sums.
    """
    merged = []
    for sights in zip(*eyes, strict=True):
        seen = [sight for sight in sights if sight.is_visible]
        merged.append(
            Sight(
                is_visible=True,
                visible_px=sum(sight.visible_px for sight in seen),
                head_px=max(sight.head_px for sight in seen),
                hidden_ratio=min(sight.hidden_ratio for sight in seen),
                num_views=len(seen),
            )
            if seen
            else NOTHING
        )
    return merged


class _Outline(NamedTuple):
    """An ellipsoid as the camera sees it. Scalars throughout: of so few heads they are faster than
    arrays."""

    depth: float
    """Metres from the camera to its middle."""
    reach: float
    """How much nearer and farther it goes."""
    # The ellipse in clip space: (x + a u, y + b u + c v) with u^2 + v^2 <= 1.
    x: float
    y: float
    a: float
    b: float
    c: float
    tall: float
    """Half its height."""

    def overlaps(self, other: _Outline) -> bool:
        """Whether their boxes on the screen touch."""
        return (
            abs(self.x - other.x) <= self.a + other.a
            and abs(self.y - other.y) <= self.tall + other.tall
        )


def _outline(head: PlacedHead) -> _Outline | None:
    """The outline; its ellipse means nothing if it reaches through the camera's plane."""
    matrix = np.asarray(head.clip_from_head).tolist()
    middle = [(low + high) / 2 for low, high in zip(head.low_m, head.high_m, strict=True)]
    radii = [(high - low) / 2 for low, high in zip(head.low_m, head.high_m, strict=True)]
    m0, m1, m2 = middle
    r0, r1, r2 = radii
    # The ellipsoid is the image of the unit ball; rows x, y and w see its centre and its axes.
    (x0, x1, x2, x3), (y0, y1, y2, y3), _, (w0, w1, w2, w3) = matrix
    centre_x = x0 * m0 + x1 * m1 + x2 * m2 + x3
    centre_y = y0 * m0 + y1 * m1 + y2 * m2 + y3
    depth = w0 * m0 + w1 * m1 + w2 * m2 + w3
    x0, x1, x2 = x0 * r0, x1 * r1, x2 * r2
    y0, y1, y2 = y0 * r0, y1 * r1, y2 * r2
    w0, w1, w2 = w0 * r0, w1 * r1, w2 * r2
    squared = w0 * w0 + w1 * w1 + w2 * w2
    sum_of_all = centre_x + centre_y + depth + sum(map(abs, (x0, x1, x2, y0, y1, y2, squared)))
    if not (min(radii) > 0 and math.isfinite(sum_of_all)):
        return None
    reach = math.sqrt(squared)
    scale = depth * depth - squared
    if not (depth > 0 and scale > 0):
        return _Outline(depth, reach, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0)
    # The dual conic A A^T - c c^T, normalised: centre, and spread S = L L^T.
    x = (centre_x * depth - (x0 * w0 + x1 * w1 + x2 * w2)) / scale
    y = (centre_y * depth - (y0 * w0 + y1 * w1 + y2 * w2)) / scale
    spread_xx = (x0 * x0 + x1 * x1 + x2 * x2 - centre_x * centre_x) / scale + x * x
    spread_xy = (x0 * y0 + x1 * y1 + x2 * y2 - centre_x * centre_y) / scale + x * y
    spread_yy = (y0 * y0 + y1 * y1 + y2 * y2 - centre_y * centre_y) / scale + y * y
    a = math.sqrt(max(spread_xx, 1e-30))
    b = spread_xy / a
    c = math.sqrt(max(spread_yy - b * b, 1e-30))
    return _Outline(depth, reach, x, y, a, b, c, math.sqrt(max(spread_yy, 1e-30)))


def _sight(outline: _Outline, nearer: Sequence[_Outline], size_px: tuple[int, int]) -> Sight:
    """What can be seen of a head before which these others are."""
    half_width, half_height = size_px[0] / 2, size_px[1] / 2
    area_px = math.pi * outline.a * outline.c * half_width * half_height
    on_screen, hidden_ratio = _shares(outline, nearer)
    visible_px = area_px * on_screen * (1 - hidden_ratio)
    is_visible = hidden_ratio < HIDDEN_RATIO and visible_px >= LEAST_PX
    return Sight(
        is_visible=is_visible,
        visible_px=visible_px if is_visible else 0.0,
        head_px=2 * outline.tall * half_height,
        hidden_ratio=hidden_ratio,
        num_views=int(is_visible),
    )


def _shares(outline: _Outline, nearer: Sequence[_Outline]) -> tuple[float, float]:
    """Which share of an ellipse lies on the screen, and which share of that is hidden."""
    right, up = abs(outline.x) + outline.a, abs(outline.y) + outline.tall
    is_whole = right <= 1 and up <= 1
    hiders = [other for other in nearer if outline.overlaps(other)]
    if is_whole and not hiders:
        return 1.0, 0.0
    if abs(outline.x) - outline.a >= 1 or abs(outline.y) - outline.tall >= 1:
        return 0.0, 0.0
    unit_x, unit_y = _DISC
    x = outline.x + outline.a * unit_x
    y = outline.y + outline.b * unit_x + outline.c * unit_y
    is_on_screen = (np.abs(x) <= 1) & (np.abs(y) <= 1)
    is_hidden = np.zeros(NUM_POINTS, np.bool_)
    for hider in hiders:
        u = (x - hider.x) / hider.a
        v = (y - hider.y - hider.b * u) / hider.c
        is_hidden |= u * u + v * v <= HIDER_SIZE**2
    num_on_screen = int(np.count_nonzero(is_on_screen))
    num_hidden = int(np.count_nonzero(is_hidden & is_on_screen))
    return num_on_screen / NUM_POINTS, num_hidden / max(num_on_screen, 1)


def _disc_points(count: int) -> tuple[Float64Array, Float64Array]:
    """Points that cover the unit disc evenly: Vogel's sunflower."""
    index = np.arange(count)
    radius = np.sqrt((index + 0.5) / count)
    turn = index * math.pi * (3 - math.sqrt(5))
    return radius * np.cos(turn), radius * np.sin(turn)


_DISC = _disc_points(NUM_POINTS)
