"""How much of each head can be seen: on the screen, not cut away, not behind others. Pure.

    heads = [PlacedHead("ada", clip_from_head(camera, matrix), low_m, high_m), ...]
    sights = look(heads, (width, height))            # one camera
    sights = merge_eyes([left_sights, right_sights])     # two: drawn twice, decoded once

A head is taken for the ellipsoid in its bounding box. Its outline on the screen is an ellipse that
follows from the camera matrix alone: with the ellipsoid's dual quadric Q, the dual conic of the
outline is P Q P^T (Hartley and Zisserman, "Multiple View Geometry", 8.3). Points spread evenly over
that ellipse tell which part of it lies on the screen, and which part nearer heads hide.

Where it ends: an ellipsoid is no head, its outline covers some tenths more or less than the drawn
pixels. One that reaches through the near plane has no outline: it counts as filling the screen, and
hides nobody, for we look through it. Hiders are taken a little smaller than they are, so that a
head of which an edge is seen is not given up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]

NUM_POINTS = 64
"""Looked at per head: a hidden share is known to a few hundredths (chosen)."""
HIDER_SIZE = 0.9
"""Diameter of a hider over that of its ellipse (chosen: a head fills its box's ellipse less than
whole at chin and neck)."""
HIDDEN_RATIO = 0.98
"""From this hidden share on a head cannot be seen: one point of the 64 may be missed."""
LEAST_PX = 0.25
"""Heads that cover less than this cannot be seen (chosen: a quarter of a pixel is antialiased
away)."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedHead:
    """One head before one camera."""

    slot: str
    """Which avatar."""
    clip_from_head: FloatArray
    """``[4, 4]`` for column vectors; its last row gives metres of depth, as
    `Camera.clip_from_world` does."""
    low_m: Sequence[float]
    """Lower corner of the box around the head, head frame."""
    high_m: Sequence[float]
    """Upper corner."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Sight:
    """What can be seen of one head. Pixels are those of the drawn image."""

    is_visible: bool
    covered_px: float = 0.0
    """On the screen, hidden or not."""
    visible_px: float = 0.0
    """Of these, not hidden by nearer heads."""
    drawn_px: float = 0.0
    """As `visible_px`, summed over the eyes that draw it."""
    head_px: float = 0.0
    """Height of the whole head on the screen, also of what lies outside; at most that of the screen
    for one that reaches through the near plane."""
    hidden_ratio: float = 0.0
    """Share of what is on the screen that nearer heads hide."""
    distance_m: float = math.inf
    """Depth of its middle before the camera; negative behind it."""
    order: int = 0
    """Place from near to far, 0 is the nearest; heads that cannot be seen come last."""
    centre_px: tuple[float, float] = (0.0, 0.0)
    """Where its middle is, pixels from the upper left; for measuring motion."""
    is_crossing: bool = False
    """Whether it reaches through the near plane."""
    num_views: int = 0
    """Eyes that see it."""


NOTHING = Sight(is_visible=False)


def look(
    heads: Sequence[PlacedHead], size_px: tuple[int, int], near_m: float = 0.02
) -> dict[str, Sight]:
    """Look at heads through one camera.

    Args:
        heads: Any number, in any order; slots are unique.
        size_px: Columns and rows of the image.
        near_m: Distance of the near plane.

    Returns:
        What can be seen, by slot; a head whose matrix or box is not finite cannot be seen.
    """
    if not heads:
        return {}
    matrices = np.array([head.clip_from_head for head in heads], np.float64)
    boxes = np.array([(head.low_m, head.high_m) for head in heads], np.float64)
    middle, radii = boxes.mean(axis=1), (boxes[:, 1] - boxes[:, 0]) / 2
    # The ellipsoid is the image of the unit ball; rows x, y and w see its centre and its axes.
    rows = matrices[:, (0, 1, 3), :]
    centres = np.matmul(rows[:, :, :3], middle[:, :, None])[..., 0] + rows[:, :, 3]
    axes = rows[:, :, :3] * radii[:, None, :]
    dual = np.matmul(axes, axes.transpose(0, 2, 1)) - centres[:, :, None] * centres[:, None, :]
    depth, reach = centres[:, 2], np.sqrt(np.square(axes[:, 2]).sum(axis=1))
    is_known = np.isfinite(dual).all(axis=(1, 2)) & (radii > 0).all(axis=1)
    with np.errstate(invalid="ignore"):
        is_before = is_known & (depth + reach > near_m)
        is_crossing = is_before & (depth - reach <= near_m)
    outlined = np.flatnonzero(is_before & ~is_crossing)
    outlines = _Outlines(dual[outlined], depth[outlined], size_px)
    sights = {head.slot: NOTHING for head in heads}
    width, height = size_px
    for index in np.flatnonzero(is_crossing).tolist():
        sights[heads[index].slot] = Sight(
            is_visible=True,
            covered_px=float(width * height),
            visible_px=float(width * height),
            drawn_px=float(width * height),
            head_px=float(height),
            distance_m=float(depth[index]),
            centre_px=(width / 2, height / 2),
            is_crossing=True,
            num_views=1,
        )
    for place, index in enumerate(outlined.tolist()):
        sights[heads[index].slot] = outlines.sight(place)
    return _in_order(sights)


def merge_eyes(eyes: Sequence[Mapping[str, Sight]]) -> dict[str, Sight]:
    """What several cameras see together: of each head the most that one of them sees.

    Args:
        eyes: What `look` says for each; all of the same heads.

    Returns:
        By slot. The heads are decoded once, but drawn by every eye that sees them: `drawn_px` and
        `num_views` are sums.
    """
    merged = {}
    for slot in eyes[0]:
        seen = [eye[slot] for eye in eyes if eye[slot].is_visible]
        if not seen:
            merged[slot] = NOTHING
            continue
        best = max(seen, key=lambda sight: sight.visible_px)
        merged[slot] = Sight(
            is_visible=True,
            covered_px=max(sight.covered_px for sight in seen),
            visible_px=best.visible_px,
            drawn_px=sum(sight.drawn_px for sight in seen),
            head_px=max(sight.head_px for sight in seen),
            hidden_ratio=min(sight.hidden_ratio for sight in seen),
            distance_m=min(sight.distance_m for sight in seen),
            centre_px=best.centre_px,
            is_crossing=any(sight.is_crossing for sight in seen),
            num_views=len(seen),
        )
    return _in_order(merged)


class _Outlines:
    """The ellipses of heads that lie wholly before the near plane."""

    def __init__(self, dual: Float64Array, depth: Float64Array, size_px: tuple[int, int]) -> None:
        """Find shape, visible share and hidden share of all at once.

        Args:
            dual: Dual conics in clip space, ``[N, 3, 3]``.
            depth: Of the middles, metres, ``[N]``.
            size_px: Columns and rows of the image.
        """
        scale = -dual[:, 2, 2]  # positive: the ellipsoid does not touch w = 0
        self._depth = depth
        self._half_px = np.array(size_px) / 2
        self._centre = -dual[:, :2, 2] / scale[:, None]
        spread = dual[:, :2, :2] / scale[:, None, None]
        spread += self._centre[:, :, None] * self._centre[:, None, :]
        # Spread is S = L L^T of the ellipse centre + L u, |u| <= 1.
        self._a = np.sqrt(np.maximum(spread[:, 0, 0], 1e-30))
        self._b = spread[:, 0, 1] / self._a
        self._c = np.sqrt(np.maximum(spread[:, 1, 1] - np.square(self._b), 1e-30))
        self._tall = np.sqrt(np.maximum(spread[:, 1, 1], 0))
        unit_x, unit_y = _DISC
        x = self._centre[:, :1] + self._a[:, None] * unit_x
        y = self._centre[:, 1:] + self._b[:, None] * unit_x + self._c[:, None] * unit_y
        is_on_screen = (np.abs(x) <= 1) & (np.abs(y) <= 1)
        self._num_on_screen = is_on_screen.sum(axis=1)
        self._num_hidden = (self._is_hidden(x, y) & is_on_screen).sum(axis=1)

    def _is_hidden(self, x: Float64Array, y: Float64Array) -> npt.NDArray[np.bool_]:
        """Which points ``[N, K]`` lie behind a nearer ellipse."""
        # Axes: hidden head, its point, hider.
        right = (x[:, :, None] - self._centre[:, 0]) / self._a
        up = (y[:, :, None] - self._centre[:, 1] - self._b * right) / self._c
        is_inside = np.square(right) + np.square(up) <= HIDER_SIZE**2
        is_nearer = self._depth[None, :] < self._depth[:, None]
        hidden: npt.NDArray[np.bool_] = np.any(is_inside & is_nearer[:, None, :], axis=2)
        return hidden

    def sight(self, place: int) -> Sight:
        """What can be seen of one of them."""
        half_width, half_height = self._half_px.tolist()
        num_on_screen = int(self._num_on_screen[place])
        area_px = math.pi * float(self._a[place] * self._c[place]) * half_width * half_height
        covered_px = area_px * num_on_screen / NUM_POINTS
        hidden_ratio = int(self._num_hidden[place]) / max(num_on_screen, 1)
        visible_px = covered_px * (1 - hidden_ratio)
        x, y = self._centre[place].tolist()
        is_visible = hidden_ratio < HIDDEN_RATIO and visible_px >= LEAST_PX
        return Sight(
            is_visible=is_visible,
            covered_px=covered_px,
            visible_px=visible_px if is_visible else 0.0,
            drawn_px=visible_px if is_visible else 0.0,
            head_px=2 * float(self._tall[place]) * half_height,
            hidden_ratio=hidden_ratio,
            distance_m=float(self._depth[place]),
            centre_px=((1 + x) * half_width, (1 - y) * half_height),
            num_views=int(is_visible),
        )


def _in_order(sights: dict[str, Sight]) -> dict[str, Sight]:
    """The same, with their places from near to far."""
    ranked = sorted(
        sights, key=lambda slot: (not sights[slot].is_visible, sights[slot].distance_m, slot)
    )
    for order, slot in enumerate(ranked):
        if sights[slot].order != order:
            sights[slot] = _placed(sights[slot], order)
    return sights


def _placed(sight: Sight, order: int) -> Sight:
    # `dataclasses.replace` takes four times as long, and this is done for every head and frame.
    return Sight(
        is_visible=sight.is_visible,
        covered_px=sight.covered_px,
        visible_px=sight.visible_px,
        drawn_px=sight.drawn_px,
        head_px=sight.head_px,
        hidden_ratio=sight.hidden_ratio,
        distance_m=sight.distance_m,
        order=order,
        centre_px=sight.centre_px,
        is_crossing=sight.is_crossing,
        num_views=sight.num_views,
    )


def _disc_points(count: int) -> tuple[Float64Array, Float64Array]:
    """Points that cover the unit disc evenly: Vogel's sunflower."""
    index = np.arange(count)
    radius = np.sqrt((index + 0.5) / count)
    turn = index * math.pi * (3 - math.sqrt(5))
    return radius * np.cos(turn), radius * np.sin(turn)


_DISC = _disc_points(NUM_POINTS)
