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

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from pica_client.render.scene import NEAR_M

NUM_POINTS = 64
"""Looked at per head: a hidden share is known to a few hundredths (chosen)."""
HIDER_SIZE = 0.9
"""Diameter of a hider over that of its ellipse (chosen: a head fills its box's ellipse less than
whole at chin and neck)."""
HIDDEN_SHARE = 0.98
"""A head of which this share is hidden cannot be seen: one point of the 64 may be missed."""
LEAST_PX = 0.25
"""Heads that cover less than this cannot be seen (chosen: a quarter of a pixel is antialiased
away)."""


class Sight(NamedTuple):
    """What can be seen of one head. Pixels are those of the drawn image."""

    visible_px: float = 0.0
    """Pixels on the screen that nearer heads do not hide, summed over the eyes."""
    head_px: float = 0.0
    """Height of the whole head on the screen, also of what lies outside; at most that of the screen
    for one that reaches through the near plane."""
    num_views: int = 0
    """Eyes that see it: it is decoded once, but drawn for each."""

    @property
    def is_visible(self) -> bool:
        """Whether any eye sees it."""
        return self.num_views > 0

    def with_eye(self, other: "Sight") -> "Sight":
        """What both eyes see together."""
        return Sight(
            self.visible_px + other.visible_px,
            max(self.head_px, other.head_px),
            self.num_views + other.num_views,
        )


NOTHING = Sight()


def look(
    clip_from_head: npt.ArrayLike,
    low_m: npt.ArrayLike,
    high_m: npt.ArrayLike,
    size_px: tuple[int, int],
) -> list[Sight]:
    """What can be seen of each head through one camera.

    Args:
        clip_from_head: ``[N, 4, 4]`` for column vectors; the last rows give metres of depth, as
            those of `Camera.clip_from_world` do. A head whose matrix is not finite cannot be seen.
        low_m: Lower corners of the boxes around the heads, head frame. ``[N, 3]``.
        high_m: Their upper corners.
        size_px: Columns and rows of the camera's image.
    """
    width, height = size_px
    low, high = np.asarray(low_m, np.float64), np.asarray(high_m, np.float64)
    # The ellipsoid is the image of the unit ball; rows x, y and w see its centre and its axes.
    rows = np.asarray(clip_from_head, np.float64)[:, [0, 1, 3]]
    rows = np.where(np.isfinite(rows).all(axis=(1, 2), keepdims=True), rows, 0.0)
    centres = np.einsum("nij,nj->ni", rows[..., :3], (low + high) / 2) + rows[..., 3]
    axes = rows[..., :3] * ((high - low) / 2)[:, None]
    depths, reaches = centres[:, 2], np.linalg.norm(axes[:, 2], axis=1)
    filling = Sight(float(width * height), float(height), 1)
    sights = [filling if is_before else NOTHING for is_before in depths + reaches > NEAR_M]
    places = np.flatnonzero(depths - reaches > NEAR_M)
    centres, axes, depths = centres[places], axes[places], depths[places]
    # The dual conic A A^T - c c^T, normalised: centre, and spread S = L L^T.
    conics = centres[:, :, None] * centres[:, None] - axes @ axes.transpose(0, 2, 1)
    conics /= conics[:, 2:, 2:]
    middles = conics[:, :2, 2]
    spreads = middles[:, :, None] * middles[:, None] - conics[:, :2, :2]
    a = np.sqrt(np.maximum(spreads[:, 0, 0], 1e-30))
    b = spreads[:, 0, 1] / a
    c = np.sqrt(np.maximum(spreads[:, 1, 1] - b * b, 1e-30))
    # In clip space an ellipse is (x + a u, y + b u + c v) with u^2 + v^2 <= 1.
    u, v = _DISC
    x = middles[:, :1] + a[:, None] * u
    y = middles[:, 1:] + b[:, None] * u + c[:, None] * v
    is_on_screen = (np.abs(x) <= 1) & (np.abs(y) <= 1)
    # Each point in the disc of each head: [hider, head, point].
    every = np.s_[:, None, None]
    u = (x - middles[:, 0][every]) / a[every]
    v = (y - middles[:, 1][every] - b[every] * u) / c[every]
    is_behind = depths > depths[:, None]
    is_hidden = (is_behind[..., None] & (u * u + v * v <= HIDER_SIZE**2)).any(axis=0)
    num_on_screen = is_on_screen.sum(axis=1)
    num_seen = (is_on_screen & ~is_hidden).sum(axis=1)
    seen_px = math.pi / 4 * width * height * a * c * num_seen / NUM_POINTS
    heads_px = np.sqrt(b * b + c * c) * height
    is_seen = (num_seen > (1 - HIDDEN_SHARE) * num_on_screen) & (seen_px >= LEAST_PX)
    for place, seen, px, head_px in zip(
        places.tolist(), is_seen.tolist(), seen_px.tolist(), heads_px.tolist(), strict=True
    ):
        sights[place] = Sight(px, head_px, 1) if seen else NOTHING
    return sights


def _disc_points(count: int) -> npt.NDArray[np.float64]:
    """Points that cover the unit disc evenly: Vogel's sunflower. ``[2, count]``."""
    index = np.arange(count)
    radius = np.sqrt((index + 0.5) / count)
    turn = index * math.pi * (3 - math.sqrt(5))
    return np.stack([radius * np.cos(turn), radius * np.sin(turn)])


_DISC = _disc_points(NUM_POINTS)
