"""A surface across the mouth of a mesh that has nothing inside it, from lip to lip.

Trackers follow lips, not teeth and tongue; models that draw a tracker's mesh paint the inside of
the mouth on such a surface. It is spanned by the border that the lips have without their inside:
the same places again, with texture coordinates of their own in a free part of the UV square. So it
moves as the lips do, closes with them, and needs no position that a tracker does not give.
"""

from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw

from pica_core.capture.dataset.files import MAP_SIZE
from pica_core.capture.triangles import edges
from pica_core.types import BoolArray, FloatArray, Int64Array

SIZES = ((64, 32), (56, 28), (48, 24), (40, 20), (32, 16), (24, 12))
"""Columns and rows that the surface may take on the position map, texels; the first that is free.
A mouth is about twice as wide as it opens."""
MARGIN = 2
"""Free texels around it."""
LIP_SHARE = 0.8
"""Share of a border's vertices that lie in the region of the lips if it is the mouth's."""


class MouthCover(NamedTuple):
    """Vertices to add to a mesh, and triangles over them and the mesh's own.

    Attributes:
        source: Vertex of the mesh whose place each new vertex shares. int64 ``[M]``.
        uv: Their texture coordinates, on texel centres of the position map. float32 ``[M, 2]``.
        faces: Triangles over new vertices, numbered from 0, turned as the mesh's are. ``[F, 3]``.
    """

    source: Int64Array
    uv: FloatArray
    faces: Int64Array


def cover_mouth(
    faces: Int64Array,
    vertex_uv: FloatArray,
    places: Int64Array,
    open_m: FloatArray,
    lips: BoolArray,
) -> MouthCover | None:
    """Span a mesh's mouth; None where no border lies along the lips, or no part of the UV is free.

    Args:
        faces: Triangles of the mesh. ``[F, 3]``.
        vertex_uv: Its texture coordinates. ``[V, 2]``.
        places: Number of each vertex's place; vertices at one place bear one number. ``[V]``.
        open_m: Its vertices with the mouth open, metres. ``[V, 3]``.
        lips: Which vertices belong to the lips. ``[V]``.
    """
    numbers, index = np.unique(places, return_index=True)
    first = np.zeros(numbers[-1] + 1, np.int64)  # the first vertex at each place
    first[numbers] = index
    borders = [(np.count_nonzero(lips[first[loop]]), loop) for loop in _borders(places[faces])]
    count, border = max(borders, key=lambda pair: pair[0], default=(0, np.zeros(0, np.int64)))
    if not count or count < LIP_SHARE * len(border):
        return None
    upper, lower = _lips(first[border], open_m)
    free = _free_rectangle(faces, vertex_uv, max(len(upper), len(lower)))
    if free is None:
        return None
    left, top, columns, rows = free
    source = np.concatenate([upper, lower[1:-1]])
    column = np.concatenate(
        [_columns(open_m[upper], columns), _columns(open_m[lower], columns)[1:-1]]
    )
    row = np.zeros(len(source))
    row[len(upper) :] = rows - 1
    row[[0, len(upper) - 1]] = rows // 2
    texel = np.stack([left + column, top + row], axis=1)
    above = np.arange(len(upper))
    below = np.concatenate([[0], len(upper) + np.arange(len(lower) - 2), [len(upper) - 1]])
    strip = _strip(above, below, column)
    ring = {(int(a), int(b)) for a, b in zip(border, np.roll(border, -1), strict=True)}
    corners = places[source][strip]
    # Triangles on both sides of an edge run along it in opposite directions.
    if any((a, b) in ring for a, b in edges(corners).tolist()):
        strip = strip[:, ::-1]
    return MouthCover(source, ((texel + 0.5) / MAP_SIZE).astype(np.float32), strip)


def _borders(faces: Int64Array) -> list[Int64Array]:
    """Closed borders, as places in the direction of the triangles beside them."""
    sides = edges(faces)
    undirected = np.sort(sides, axis=1)
    _, index, uses = np.unique(undirected, axis=0, return_inverse=True, return_counts=True)
    alone = sides[uses[index.reshape(-1)] == 1]
    after = dict(alone.tolist())
    loops, seen = [], set[int]()
    for start in after:
        loop, place = [], start
        while place in after and place not in seen:
            seen.add(place)
            loop.append(place)
            place = after[place]
        if len(loop) > 2 and place == start:
            loops.append(np.array(loop))
    return loops


def _lips(loop: Int64Array, open_m: FloatArray) -> tuple[Int64Array, Int64Array]:
    """Upper and lower border, both from the corner at the subject's right to that at the left."""
    x = open_m[loop, 0]
    loop = np.roll(loop, -int(x.argmin()))
    corner = int(open_m[loop, 0].argmax())
    one, other = loop[: corner + 1], np.append(loop[corner:], loop[0])[::-1]
    if open_m[one, 1].mean() < open_m[other, 1].mean():
        one, other = other, one
    return one, other


def _columns(points_m: FloatArray, count: int) -> Int64Array:
    """A column for each point of a line, by its length along the line; no two share one."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points_m, axis=0), axis=1)))
    column = np.rint(along / along[-1] * (count - 1)).astype(np.int64)
    steps = np.arange(len(column))
    column = np.maximum.accumulate(column - steps) + steps
    return np.minimum(column, count - len(column) + steps)


def _strip(above: Int64Array, below: Int64Array, column: Int64Array) -> Int64Array:
    """Triangles between two lines with common ends, going from left to right over the columns."""
    triangles, i, j = [], 0, 0
    while i + 1 < len(above) or j + 1 < len(below):
        goes_above = j + 1 == len(below) or (
            i + 1 < len(above) and column[above[i + 1]] <= column[below[j + 1]]
        )
        triangles.append((above[i], below[j], above[i + 1] if goes_above else below[j + 1]))
        i, j = (i + 1, j) if goes_above else (i, j + 1)
    strip = np.array(triangles)
    a, b, c = strip.T
    return strip[(a != b) & (b != c) & (c != a)]


def _free_rectangle(
    faces: Int64Array, vertex_uv: FloatArray, least_columns: int
) -> tuple[int, int, int, int] | None:
    """Left, top, columns and rows of a part of the position map that no triangle touches."""
    page = Image.new("L", (MAP_SIZE, MAP_SIZE))
    draw = ImageDraw.Draw(page)
    for corners in (vertex_uv[faces] * MAP_SIZE).astype(np.float64):
        draw.polygon([(float(u), float(v)) for u, v in corners], fill=1, outline=1)
    used = np.zeros((MAP_SIZE + 1, MAP_SIZE + 1), np.int64)
    used[1:, 1:] = np.asarray(page).cumsum(0, dtype=np.int64).cumsum(1)
    for columns, rows in SIZES:
        if columns < least_columns:
            return None
        w, h = columns + 2 * MARGIN, rows + 2 * MARGIN
        inside = used[h:, w:] - used[:-h, w:] - used[h:, :-w] + used[:-h, :-w]
        free = np.argwhere(inside == 0)
        if len(free):
            top, left = (int(value) + MARGIN for value in free[0])
            return left, top, columns, rows
    return None
