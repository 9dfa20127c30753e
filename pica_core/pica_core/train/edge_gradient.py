"""How the picture changes where one surface covers another: the gradient that interpolation lacks.

The idea is that of differentiable rasterisers with an edge term (DRTK, Pidhorskyi et al. 2024);
derivation and code are ours. Let I be the picture before it is sampled, and let a pixel's value be
its mean over an area around the pixel's centre. When the covering surface moves on the screen with
velocity w = (w_x, w_y), a boundary element of length s with outward normal n = (n_x, n_y) sweeps
the area s (n . w), in which the covered colour C_b becomes the covering one C_f:

    d(sum of pixel values) = (C_f - C_b) s (n_x w_x + n_y w_y)

The boundary is not known, but it can be counted. It passes s |n_x| times between horizontal
neighbours (p, q) of pixels and s |n_y| times between vertical ones. So let every horizontal pair
with a boundary between them stand for sign (C_f - C_b) w_x, and every vertical one for
sign (C_f - C_b) w_y, where sign is +1 if the covered pixel lies at the larger coordinate (then n
points that way): summed over the element both kinds give exactly the line above, for every slope of
the boundary, and no edge of a triangle has to be found. That matters here, where triangles are
smaller than pixels. Where between p and q the boundary lies is not known either; on average it
belongs to both alike, so either pixel takes half.

w is the velocity of the surface point that the covering pixel sees, with its interpolation weights
held: the boundary moves with the surface that makes it. Left out: rims that are no boundary of the
mesh but the turning-away of a round surface move a little differently (to first order they do not);
lines where two surfaces cut through each other, which have no gap in depth.

The term has the value 0; only its gradient is something.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from torch import Tensor

from pica_core.types import FloatArray, Int64Array

GAP_M = 0.003
"""Least step in depth between two surfaces that counts as a boundary, metres (chosen: well above
depth differences of neighbouring pixels of one face, below the gap of an open mouth)."""


class Edges(NamedTuple):
    """E pairs of neighbouring pixels with a boundary between them, as flat indices.

    Attributes:
        front: The covering pixel, int64 ``[E]``.
        back: The covered one, or the background, int64 ``[E]``.
        axis: 0 for horizontal pairs (x), 1 for vertical ones (y), int64 ``[E]``.
        sign: +1 where `back` lies at the larger coordinate, else -1, float32 ``[E]``.
    """

    front: Int64Array
    back: Int64Array
    axis: Int64Array
    sign: FloatArray

    def chosen(self, places: Int64Array) -> Edges:
        """Some of the pairs."""
        return Edges(self.front[places], self.back[places], self.axis[places], self.sign[places])


def find_edges(depth_m: FloatArray) -> Edges:
    """Pairs of neighbours between which the surface breaks off.

    Two covered neighbours do so if their depths differ by more than `GAP_M`, and neither depth is
    what the other side leads to in a straight line (so that slanted surfaces stay whole).

    Args:
        depth_m: Depth along the camera's axis, 0 where nothing is, ``[H, W]``.
    """
    index = np.arange(depth_m.size, dtype=np.int64).reshape(depth_m.shape)
    parts = []
    for axis in (0, 1):
        depth, flat = (depth_m, index) if axis == 0 else (depth_m.T, index.T)
        first, second = depth[:, :-1], depth[:, 1:]
        lead = np.pad(depth, ((0, 0), (1, 1)))
        before, after = lead[:, :-3], lead[:, 3:]
        from_first = np.where(before > 0, 2 * first - before, first)
        from_second = np.where(after > 0, 2 * second - after, second)
        broken = (
            (np.abs(second - first) > GAP_M)
            & (np.abs(second - from_first) > GAP_M)
            & (np.abs(first - from_second) > GAP_M)
        )
        both = (first > 0) & (second > 0)
        edge = (both & broken) | ((first > 0) != (second > 0))
        first_in_front = (first > 0) & ((second == 0) | (first < second))
        one, two, lower = flat[:, :-1][edge], flat[:, 1:][edge], first_in_front[edge]
        parts.append(
            Edges(
                np.where(lower, one, two),
                np.where(lower, two, one),
                np.full(len(one), axis, np.int64),
                np.where(lower, 1, -1).astype(np.float32),
            )
        )
    return Edges(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def screen_positions(
    camera_points_m: Tensor, corners: Tensor, weights: Tensor, intrinsics: Tensor
) -> Tensor:
    """Where the surface points of pixels lie on the screen; they move with their triangles.

    Args:
        camera_points_m: Vertices in camera axes, metres, ``[V, 3]``; gradients flow to it.
        corners: The vertices of each pixel's triangle, int64 ``[P, 3]``.
        weights: The pixels' interpolation weights, ``[P, 3]``; held, no gradient.
        intrinsics: Of each pixel's camera, ``[P, 3, 3]``, or of one for all, ``[3, 3]``.

    Returns:
        Pixel coordinates x, y, ``[P, 2]``.
    """
    points = (weights.detach()[:, :, None] * camera_points_m[corners]).sum(1)
    image = (intrinsics @ points[:, :, None])[:, :, 0]
    return image[:, :2] / image[:, 2:]


def edge_term(
    front_colours: Tensor,
    back_colours: Tensor,
    front_gradients: Tensor,
    back_gradients: Tensor,
    positions: Tensor,
    signs: Tensor,
) -> Tensor:
    """A number of value 0 whose gradient is what the boundaries add to the gradient of a loss.

    Args:
        front_colours: Predicted colours of the covering pixels, ``[E, 3]``.
        back_colours: Predicted colours of the covered pixels or of the background, ``[E, 3]``.
        front_gradients: The loss's derivative by the covering pixels' colours, ``[E, 3]``.
        back_gradients: The same of the covered pixels; 0 where the loss does not look, ``[E, 3]``.
        positions: Screen coordinate of the covering pixels' surface points along each pair's axis,
            from `screen_positions`, pixels, ``[E]``.
        signs: From `Edges`, ``[E]``.
    """
    step = (front_colours - back_colours).detach()
    felt = 0.5 * (front_gradients + back_gradients).detach()
    moved = positions - positions.detach()
    return ((felt * step).sum(1) * signs * moved).sum()
