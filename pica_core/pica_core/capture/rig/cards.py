"""Cut triangles along the edge of their picture: brows, lashes and lace as cards.

A card's picture is opaque where there is something. A triangle that is opaque in part is divided
into `PARTS` squared ones, which are cut where opacity, linear between their corners, crosses the
cutoff.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from pica_core.types import Array, BoolArray, Float64Array, Int64Array, IntArray

PARTS = 4
"""Parts of a triangle's edge (chosen: a tenth of an eyelash card's height)."""
_GRID = [(i, j) for i in range(PARTS + 1) for j in range(PARTS + 1 - i)]
_POINTS = np.array([(i, j, PARTS - i - j) for i, j in _GRID]) / PARTS
_AT = {place: number for number, place in enumerate(_GRID)}
_PIECES = np.array(
    [(_AT[i, j], _AT[i + 1, j], _AT[i, j + 1]) for i, j in _GRID if i + j < PARTS]
    + [(_AT[i + 1, j], _AT[i + 1, j + 1], _AT[i, j + 1]) for i, j in _GRID if i + j < PARTS - 1]
)
_DIGITS = 6
"""Decimals of a corner's weights by which corners of neighbours are the same."""


def cut(
    faces: IntArray, opacity: Callable[[Int64Array, Float64Array], Float64Array], cutoff: float
) -> tuple[BoolArray, Int64Array, Float64Array, Int64Array]:
    """Cut triangles where they begin to be seen through.

    Args:
        faces: Triangles in vertices. ``[F, 3]``.
        opacity: Gives the opacity 0 to 1 of triangles ``[n]`` at barycentric points ``[k, 3]``,
            ``[n, k]``.
        cutoff: Opacity from which on a point is solid.

    Returns:
        Which triangles stay whole ``[F]``; and of the pieces of others: new vertices as three old
        ones and their weights ``[N, 3]``, and triangles in new vertices ``[P, 3]``.
    """
    solid = opacity(np.arange(len(faces)), _POINTS) - cutoff
    whole = np.all(solid >= 0, axis=1)
    mixed = np.flatnonzero(np.any(solid >= 0, axis=1) & ~whole)
    corners: list[Array] = []
    for piece in _PIECES:
        values = solid[mixed][:, piece]
        for inside in range(1, 8):
            chosen = np.flatnonzero(((values >= 0) @ [1, 2, 4]) == inside)
            polygon = _clip(
                values[chosen], _POINTS[piece], [bool(inside >> k & 1) for k in range(3)]
            )
            for one, other in pairwise(range(1, polygon.shape[1])):
                weights = polygon[:, [0, one, other]]
                at = np.broadcast_to(faces[mixed[chosen], None], weights.shape)
                corners.append(np.stack([at, weights], -1))
    if not corners:
        return whole, np.zeros((0, 3), np.int64), np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    rows = np.concatenate(corners).reshape(-1, 3, 2)
    rows[..., 1] = np.round(rows[..., 1], _DIGITS)
    rows[rows[..., 1] == 0] = 0  # so that both triangles of an edge name its points alike
    rows = np.take_along_axis(rows, np.argsort(rows[..., 0], axis=1, kind="stable")[..., None], 1)
    unique, pieces = np.unique(rows.reshape(-1, 6), axis=0, return_inverse=True)
    unique = unique.reshape(-1, 3, 2)
    weights = unique[..., 1] / unique[..., 1].sum(1, keepdims=True)
    return whole, unique[..., 0].astype(np.int64), weights, pieces.reshape(-1, 3)


def _clip(values: Float64Array, points: Float64Array, inside: list[bool]) -> Float64Array:
    """The solid part of one piece in many triangles, as barycentric points ``[n, 3 or 4, 3]``.

    `values` are the corners' opacities above the cutoff ``[n, 3]``, negative where not `inside`.
    """
    found = []
    for k in range(3):
        after = (k + 1) % 3
        if inside[k]:
            found.append(np.broadcast_to(points[k], (len(values), 3)))
        if inside[k] != inside[after]:
            share = (values[:, k] / (values[:, k] - values[:, after]))[:, None]
            found.append(points[k] + share * (points[after] - points[k]))
    return np.stack(found, 1)
