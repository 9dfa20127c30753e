"""Skirts: islands reach a triangle under each other, so that a decoded head shows no cracks.

A decoder that is not perfect puts the two copies of a vertex at a seam in slightly different
places, and a gap opens along the seam. So each island gets copies of the triangles on the far side
of its seams, unfolded into its own plane: they close the gap from below.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float64Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]
IndexArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

MAX_SKIRT_TEXELS = 2.5
"""How far a skirt reaches from the seam, at most."""


def find_seams(split: IntArray, faces: IntArray) -> tuple[IndexArray, IndexArray]:
    """Edges that two triangles share in space and not in the plane.

    Args:
        split: Triangles in split vertices. ``[F, 3]``.
        faces: The same triangles in welded vertices. ``[F, 3]``.

    Returns:
        The half-edges on both sides, each as 3 * face + corner: two int64 ``[S]``.
    """
    start = faces.astype(np.int64)
    end = np.roll(start, -1, axis=1)
    low, high = np.minimum(start, end).ravel(), np.maximum(start, end).ravel()
    key = low * (int(faces.max()) + 1) + high
    order = np.argsort(key, kind="stable")
    _, first, count = np.unique(key[order], return_index=True, return_counts=True)
    pairs = first[count == 2]
    one, other = order[pairs], order[pairs + 1]
    ends = np.stack([split, np.roll(split, -1, axis=1)], -1).reshape(-1, 2)
    same = (np.sort(ends[one], 1) == np.sort(ends[other], 1)).all(1)
    # Triangles of opposite winding run along their edge in opposite directions; others are left.
    opposite = start.ravel()[one] != start.ravel()[other]
    chosen = ~same & opposite
    return one[chosen], other[chosen]


def add_skirts(
    points: Float64Array,
    split: IntArray,
    rest: Float64Array,
    faces: IntArray,
    seen: BoolArray,
    reach: float,
) -> tuple[Float64Array, IntArray, IndexArray, IndexArray]:
    """Let islands reach under their neighbours.

    Args:
        points: Split vertices in the plane. ``[V, 2]``.
        split: Triangles in split vertices. ``[F, 3]``.
        rest: Welded vertices in space. ``[P, 3]``.
        faces: The same triangles in welded vertices. ``[F, 3]``.
        seen: Triangles that need skirts. bool ``[F]``.
        reach: How far a skirt may reach in the plane.

    Returns:
        New points ``[N, 2]``, new triangles in split vertices (new ones counted on from V)
        ``[N, 3]``, the welded vertex of each new point ``[N]``, and the triangle that each new one
        copies ``[N]``.
    """
    one, other = find_seams(split, faces)
    mine = np.concatenate([one, other])
    theirs = np.concatenate([other, one])
    wanted = seen[mine // 3] | seen[theirs // 3]
    mine, theirs = mine[wanted], theirs[wanted]
    face, corner = mine // 3, mine % 3
    begin, end = split[face, corner], split[face, (corner + 1) % 3]
    own = split[face, (corner + 2) % 3]
    far = faces[theirs // 3, (theirs % 3 + 2) % 3].astype(np.int64)
    a, b = rest[faces[face, corner]], rest[faces[face, (corner + 1) % 3]]
    edge = b - a
    square = np.maximum((edge * edge).sum(1), 1e-18)
    along = ((rest[far] - a) * edge).sum(1) / square
    away = np.linalg.norm(rest[far] - a - along[:, None] * edge, axis=1) / np.sqrt(square)
    flat = points[end] - points[begin]
    length = np.maximum(np.linalg.norm(flat, axis=1), 1e-18)
    normal = np.stack([-flat[:, 1], flat[:, 0]], 1)
    inside = ((points[own] - points[begin]) * normal).sum(1)
    normal *= -np.sign(inside)[:, None]
    away = np.minimum(away, reach / length)
    tip = points[begin] + np.clip(along, 0.0, 1.0)[:, None] * flat + away[:, None] * normal
    index = len(points) + np.arange(len(tip))
    skirts = np.stack([end, begin, index], 1)
    return tip, _as_copied(skirts, theirs % 3), far, (theirs // 3).astype(np.int64)


def _as_copied(triangles: IndexArray, corner: IndexArray) -> IntArray:
    """Turn triangles until their first vertex is in this corner, as in what they copy."""
    turned = np.take_along_axis(triangles, (np.arange(3) - corner[:, None]) % 3, 1)
    return turned.astype(np.int32)
