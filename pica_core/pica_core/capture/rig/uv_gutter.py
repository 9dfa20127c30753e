"""Gutters: islands reach a triangle under each other, so that a decoded head shows no cracks.

A decoder that is not perfect puts the two copies of a vertex at a seam in slightly different
places, and a gap opens along the seam. So each island gets copies of the triangles on the far side
of its seams, unfolded into its own plane: they close the gap from below. Where such a copy and the
next along the seam leave a triangle between them, at the vertex that they share, that is copied,
too; it needs no point of its own.
"""

import numpy as np

from pica_core.capture.triangles import signed_areas
from pica_core.types import BoolArray, Float64Array, Int64Array, IntArray

MAX_GUTTER_TEXELS = 2.5
"""How far a gutter reaches from the seam, at most."""


def find_seams(split: IntArray, faces: IntArray) -> tuple[Int64Array, Int64Array]:
    """Edges that two triangles share in space (`faces`) and not in the plane (`split`).

    Returns the half-edges on both sides, each as 3 * face + corner: two int64 ``[S]``.
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


def add_gutters(
    points: Float64Array,
    split: IntArray,
    rest: Float64Array,
    faces: IntArray,
    seen: BoolArray,
    reach: float,
) -> tuple[Float64Array, IntArray, Int64Array, Int64Array]:
    """Let islands reach under those beside them.

    Args:
        points: Split vertices in the plane. ``[V, 2]``.
        split: Triangles in split vertices. ``[F, 3]``.
        rest: Welded vertices in space. ``[P, 3]``.
        faces: The same triangles in welded vertices. ``[F, 3]``.
        seen: Triangles that need gutters. bool ``[F]``.
        reach: How far a gutter may reach in the plane.

    Returns:
        New points ``[N, 2]``, new triangles with those counted on from V, the welded vertex of each
        new point ``[N]``, and the triangle that each new triangle copies.
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
    gutters = np.stack([end, begin, index], 1)
    welded = np.stack([faces[face, (corner + 1) % 3], far], 1).astype(np.int64)
    between, copied = _between(np.concatenate([points, tip]), faces, gutters, welded)
    triangles = np.concatenate([_as_copied(gutters, theirs % 3), between])
    return tip, triangles, far, np.concatenate([theirs // 3, copied]).astype(np.int64)


def _as_copied(triangles: Int64Array, corner: Int64Array) -> IntArray:
    """Turn triangles until their first vertex is in this corner, as in what they copy."""
    turned = np.take_along_axis(triangles, (np.arange(3) - corner[:, None]) % 3, 1)
    return turned.astype(np.int32)


def _between(
    points: Float64Array, faces: IntArray, gutters: Int64Array, welded: Int64Array
) -> tuple[IntArray, Int64Array]:
    """Triangles between gutters that follow each other along a seam, and what each copies.

    A gutter is its edge's end and begin, and its tip, in `points`; `welded` has end and tip in
    welded vertices. Where the far side has several triangles between two gutters there is none.
    """
    end, begin, tip = gutters.T
    next_skirt = np.full(len(points), -1)
    next_skirt[begin] = np.arange(len(gutters))
    single = np.bincount(begin, minlength=len(points))[end] == 1
    one = np.flatnonzero(single & (np.bincount(end, minlength=len(points))[end] == 1))
    other = next_skirt[end[one]]
    # Triangles of the mesh by two corners that follow each other; the third must fit as well.
    count = int(faces.max()) + 1
    start = faces.astype(np.int64)
    key = (start * count + np.roll(start, -1, axis=1)).ravel()
    order = np.argsort(key, kind="stable")
    wanted = welded[one, 0] * count + welded[one, 1]
    place = order[np.minimum(np.searchsorted(key[order], wanted), len(order) - 1)]
    third = faces[place // 3, (place % 3 + 2) % 3]
    triangles = np.stack([end[one], tip[one], tip[other]], 1)
    # Where the areas differ in sign, gutters overlap.
    alike = signed_areas(points, triangles) * signed_areas(points, gutters[one]) > 0
    fits = (key[place] == wanted) & (third == welded[other, 1]) & alike
    return _as_copied(triangles[fits], place[fits] % 3), place[fits] // 3
