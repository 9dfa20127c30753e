"""One 0-1 chart for a whole rig: every island of the file's UVs, scaled to its need and packed.

    islands -> need of each triangle -> scale -> pack (xatlas)

Meshes without UVs get islands from xatlas first. Those of the face model were stretched once, so
that each triangle has the area that it needs: a 256 x 256 position map has about two texels for a
vertex of a detailed head, and lids, lips and teeth crowd them.
"""

from dataclasses import dataclass

import numpy as np
import xatlas

from pica_core.avatar.spec import MAP_SIZE
from pica_core.capture.triangles import areas, components, signed_areas
from pica_core.errors import CaptureError
from pica_core.types import BoolArray, Float64Array, FloatArray, Int64Array, IntArray

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
    """Let islands reach a triangle under each other, so that a decoded head shows no cracks.

    A decoder puts the two copies of a vertex at a seam in slightly different places, and a gap
    opens. So each island gets copies of the triangles on the far side of its seams, unfolded into
    its own plane; a triangle between two such copies at a shared vertex is copied, too.

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


USUAL_FILL = 0.55
"""Share of the square that islands cover in the end, about."""
MAX_FOLDED = 0.1
"""Share of an island that may be folded over, at most; more and it gets new coordinates."""
LEAST_AREA = 1e-5
"""Area of a triangle in the plane, of the median, below which it is a line."""
MAX_PACKED = 500_000
"""Triangles that are packed, all tries together; three tries are made of any (chosen: nine of the
most detailed head that was seen, in about 2 s)."""
MAX_ISLANDS = 2_000
"""Of a chart (chosen: 3,000 of a texel each did not fit, which packers took 10 s to say)."""
PADDING_TEXELS = 1
"""Empty texels between islands beyond those that bilinear lookup reads: it never mixes two."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PackedChart:
    """A mesh with one chart.

    Attributes:
        vertex_uv: Texture coordinates in [0, 1], v downwards. float32 ``[V, 2]``.
        faces: Triangles of the split vertices. int32 ``[F, 3]``.
        face_source: The triangle of the mesh that each triangle is, or copies. int64 ``[F]``.
        source: The welded vertex of each split vertex. int64 ``[V]``.
    """

    vertex_uv: FloatArray
    faces: IntArray
    face_source: Int64Array
    source: Int64Array


def make_islands(points: Float64Array, faces: IntArray) -> tuple[Float64Array, IntArray]:
    """Texture coordinates ``[T, 2]`` for a mesh that has none, and the triangles in them."""
    options = xatlas.ChartOptions()
    options.max_iterations = 4
    options.max_cost = 16.0  # few, large islands: every seam costs texels and splits vertices
    options.normal_deviation_weight = 1.0
    atlas = xatlas.Atlas()
    atlas.add_mesh(points.astype(np.float32), faces.astype(np.uint32))
    atlas.generate(chart_options=options)
    _, index, uv = atlas[0]
    if len(index) != len(faces):
        raise CaptureError(f"only {len(index)} of {len(faces)} triangles could be laid flat")
    return uv.astype(np.float64), index.astype(np.int32)


def mend_islands(
    points: Float64Array, faces: IntArray, uv: Float64Array, uv_faces: IntArray
) -> tuple[Float64Array, IntArray, int]:
    """Replace islands that lie on a point, on a line, or folded over themselves (mirrored halves),
    and single triangles that are lines: packers tear these off.

    Returns coordinates, triangles in them, and how many triangles got new ones.
    """
    area = signed_areas(uv, uv_faces)
    label = components(uv_faces, len(uv))[uv_faces[:, 0]]
    _, island = np.unique(label, return_inverse=True)
    flat = np.bincount(island, np.abs(area))
    folded = flat - np.abs(np.bincount(island, area))
    ratio = flat / np.maximum(np.bincount(island, areas(points, faces)), 1e-12)
    usual = float(np.median(ratio[island]))
    bad = (flat <= 0) | (folded > MAX_FOLDED * flat) | (ratio < 1e-4 * usual)
    mend = bad[island] | (np.abs(area) < LEAST_AREA * np.median(np.abs(area)))
    if not mend.any():
        return uv, uv_faces, 0
    new_uv, new_faces = make_islands(points, np.ascontiguousarray(faces[mend]))
    mended = uv_faces.copy()
    mended[mend] = new_faces + len(uv)
    return np.concatenate([uv, new_uv]), mended, int(np.count_nonzero(mend))


def pack(
    uv: Float64Array,
    uv_faces: IntArray,
    faces: IntArray,
    need: Float64Array,
    *,
    rest: Float64Array,
    seen: BoolArray,
) -> PackedChart:
    """Put all islands into one square.

    Args:
        uv: Texture coordinates; islands may lie in different tiles or over each other. ``[T, 2]``.
        uv_faces: Triangles in `uv`. ``[F, 3]``.
        faces: The same triangles in welded vertices. ``[F, 3]``.
        need: Wanted share of each triangle. ``[F]``.
        rest: Welded vertices in space. ``[P, 3]``.
        seen: Triangles whose seams need gutters. bool ``[F]``.

    Raises:
        CaptureError: There are too many islands, or they cannot be packed.
    """
    # A vertex of two islands (mirrored halves on one place) is two vertices.
    joint = np.stack([uv_faces.ravel(), faces.ravel()], 1).astype(np.int64)
    pairs, index = np.unique(joint, axis=0, return_inverse=True)
    split = index.reshape(-1, 3).astype(np.int32)
    points = uv[pairs[:, 0]].astype(np.float64)
    label = components(split, len(points))[split[:, 0]]
    floor = 1e-12 + 1e-3 * np.median(np.abs(signed_areas(points, split)))
    names = np.unique(label)
    if len(names) > MAX_ISLANDS:
        raise CaptureError(f"{len(names)} islands in one chart; up to {MAX_ISLANDS} are packed")
    for number, name in enumerate(names):
        mine = np.flatnonzero(label == name)
        used, again = np.unique(split[mine], return_inverse=True)
        local: IntArray = again.reshape(-1, 3).astype(np.int32)
        island = points[used] - points[used].mean(0)
        signed = signed_areas(island, local)
        if signed.sum() < 0:
            island[:, 0] *= -1
            signed = -signed
        island *= np.sqrt(need[mine].sum() / max(np.abs(signed).sum(), floor))
        points[used] = island + 0.1 * number  # packers slow down where many are alike in one place
    texel = np.sqrt(np.abs(signed_areas(points, split)).sum() / USUAL_FILL) / MAP_SIZE
    reach = MAX_GUTTER_TEXELS * texel
    tips, gutters, far, copied = add_gutters(points, split, rest, faces, seen, reach)
    split = np.concatenate([split, gutters])
    return PackedChart(
        vertex_uv=_place(np.concatenate([points, tips]), split).astype(np.float32),
        faces=split,
        face_source=np.concatenate([np.arange(len(faces)), copied]),
        source=np.concatenate([pairs[:, 1], far]),
    )


def _place(points: Float64Array, faces: IntArray) -> Float64Array:
    """Pack islands at the largest common scale that fits into the position map."""
    area = float(np.abs(signed_areas(points, faces)).sum())
    unit = points / np.sqrt(area)  # all islands together have area 1
    best: Float64Array | None = None
    low, high = 0.25 * MAP_SIZE, 1.0 * MAP_SIZE
    for _ in range(min(max(MAX_PACKED // len(faces), 3), 9)):
        scale = 0.5 * (low + high)
        placed = _try(unit * scale, faces)
        if placed is None:
            high = scale
        else:
            low, best = scale, placed
    if best is None:
        raise CaptureError("the islands of this mesh do not fit into one chart")
    return best


def _try(points: Float64Array, faces: IntArray) -> Float64Array | None:
    """Islands in texels to places in [0, 1], or None when they do not fit."""
    options = xatlas.PackOptions()
    options.resolution = MAP_SIZE
    options.texels_per_unit = 1.0
    options.padding = PADDING_TEXELS
    options.bilinear = True
    options.rotate_charts = True
    options.rotate_charts_to_axis = False
    options.bruteForce = True
    atlas = xatlas.Atlas()
    atlas.add_uv_mesh(points.astype(np.float32), faces.astype(np.uint32))
    atlas.generate(pack_options=options)
    if atlas.atlas_count != 1 or max(atlas.width, atlas.height) > MAP_SIZE:
        return None
    vertex, index, uv = atlas[0]
    placed = np.full((len(points), 2), np.nan)
    placed[vertex] = uv * [atlas.width / MAP_SIZE, atlas.height / MAP_SIZE]
    # More vertices than before: one was torn off, and would draw its triangles over others.
    if len(index) != len(faces) or len(vertex) > len(points) or np.isnan(placed).any():
        return None
    return placed
