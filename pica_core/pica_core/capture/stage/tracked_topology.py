"""The mesh that a tracker would follow: some 7,000 of the dense vertices, no inside of the mouth.

Seeds are spread over the surface by farthest-point choice, denser where faces move and look; every
dense vertex joins the seed that is nearest along the surface, and wherever three such patches meet
there is a triangle (the dual of a Voronoi diagram on the mesh). The result is a subset of the
dense vertices with their UVs, so the exact position of a tracked vertex is always known.

Both sides of a UV seam keep the same seeds, and vertices of a border or slit join seeds of their
border only, so lips and lids keep their slits and seams do not open. A surface from lip to lip
covers the mouth (`mouth_cover`); its vertices are vertices of the lips once more.
"""

from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from pica_core.capture.dataset.files import MAP_SIZE, Topology
from pica_core.capture.triangles import edges
from pica_core.types import BoolArray, FloatArray, Int64Array

NUM_VERTICES = 7000
"""Vertices that are aimed at (paper: 5K; the published Multiface meshes have 7,306)."""
UNTRACKED = "mouth_interior"
"""Region that a tracker cannot follow (paper, section 3: no vertices for tongue and teeth)."""
COVER = "mouth_cover"
"""Region of the surface that covers the mouth instead."""
DENSITY: dict[str, float] = {
    "hair": 0.6,
    "scalp": 0.6,
    "neck": 0.6,
    "collar": 0.45,
    "ears": 0.8,
    "face": 1.2,
    "mouth": 1.6,
    "lips": 2.4,
    "lids": 2.4,
}
"""How much shorter than elsewhere edges are, by region; the last that applies counts (chosen)."""
BORDER_DENSITY = 1.4
"""The same for borders, seams and slits, on top."""
SAME_PLACE_M = 2e-5
"""Vertices this near to each other in all shapes are one place with several UVs."""


def track_topology(
    topology: Topology, shapes_m: FloatArray, num_vertices: int = NUM_VERTICES
) -> tuple[Topology, Int64Array]:
    """Choose the tracked mesh of a dense one, and the dense vertex of each of its vertices.

    Args:
        shapes_m: It in a few expressions that open what is closed at rest, metres; the second opens
            the jaw. ``[K, V, 3]``.
        num_vertices: How many to aim at; a mesh that has no more stays whole.
    """
    places = np.concatenate(list(np.asarray(shapes_m, np.float32)), axis=1)
    faces = topology.faces.astype(np.int64)
    untracked = topology.region(UNTRACKED)
    faces = faces[~untracked[faces].any(axis=1)]
    unique, uses = np.unique(np.sort(edges(faces), axis=1), axis=0, return_counts=True)
    border_edges = unique[uses == 1]  # those of seams are among them
    border = np.zeros(len(places), np.bool_)
    border[border_edges] = True
    used = np.zeros(len(places), np.bool_)
    used[faces] = True
    weight = topology.by_region(DENSITY, 1.0) * np.where(border, BORDER_DENSITY, 1.0)
    cells = np.rint(places / SAME_PLACE_M).astype(np.int64)
    twins = np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1)
    seeds = _spread(places, used, weight.astype(np.float32), twins, num_vertices)
    owner = _patches(places, faces, border_edges, seeds)
    corners = owner[faces]
    a, b, c = corners.T
    corners = corners[(a != b) & (b != c) & (c != a) & (corners >= 0).all(axis=1)]
    # Patches that meet more than once would give the same triangle twice.
    turned = np.take_along_axis(
        corners, (corners.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1
    )
    turned = turned[np.unique(np.sort(turned, axis=1), axis=0, return_index=True)[1]]
    chosen, renamed = np.unique(turned, return_inverse=True)
    tracked = Topology(
        vertex_uv=topology.vertex_uv[chosen],
        faces=renamed.reshape(-1, 3).astype(np.int32),
        regions={
            name: mask[chosen] for name, mask in topology.regions.items() if name != UNTRACKED
        },
    )
    faces, lips = tracked.faces.astype(np.int64), tracked.region("lips")
    open_m = shapes_m[min(1, len(shapes_m) - 1)][chosen]
    cover = cover_mouth(faces, tracked.vertex_uv, twins[chosen], open_m, lips)
    if cover is None:
        return tracked, chosen
    every = np.concatenate([np.arange(len(chosen)), cover.source])
    covered = Topology(
        vertex_uv=np.concatenate([tracked.vertex_uv, cover.uv]),
        faces=np.concatenate([faces, len(chosen) + cover.faces]).astype(np.int32),
        regions={name: mask[every] for name, mask in tracked.regions.items()}
        | {COVER: np.arange(len(every)) >= len(chosen)},
    )
    return covered, chosen[every]


def _spread(
    places: FloatArray, used: BoolArray, weight: FloatArray, twins: Int64Array, count: int
) -> Int64Array:
    """Farthest-point choice of about `count` vertices; with each all vertices of its place."""
    index = np.flatnonzero(used)
    index = index[np.argsort(places[index, 1], kind="stable")]
    points, square_weight = places[index], weight[index] ** 2
    height = np.ascontiguousarray(points[:, 1])
    order = np.argsort(twins[index], kind="stable")
    sorted_places = twins[index][order]
    score = np.full(len(index), np.inf, np.float32)  # squared weighted distance to the chosen
    chosen: list[Int64Array] = []
    total, at = 0, 0
    while total < min(count, len(index)) and score[at] > 0.0:
        place = twins[index[at]]
        together = order[
            np.searchsorted(sorted_places, place) : np.searchsorted(sorted_places, place, "right")
        ]
        chosen.append(index[together])
        total += len(together)
        # No vertex is farther from the chosen than this one, so few can come nearer by it.
        reach = float(np.sqrt(score[at] / square_weight.min()))
        low, high = np.searchsorted(height, [height[at] - reach, height[at] + reach])
        offset = points[low:high] - points[at]
        near = np.einsum("ij,ij->i", offset, offset) * square_weight[low:high]
        np.minimum(score[low:high], near, out=score[low:high])
        score[together] = 0.0
        at = int(score.argmax())
    return np.concatenate(chosen)


def _patches(
    places: FloatArray, faces: Int64Array, border_edges: Int64Array, seeds: Int64Array
) -> Int64Array:
    """The seed that each vertex joins, -1 where it reaches none. int64 ``[V]``."""
    count = len(places)
    ring = coo_array((np.ones(len(border_edges), np.bool_), tuple(border_edges.T)), (count, count))
    label = connected_components(ring, directed=False)[1]
    # A border with a seed is joined along itself; the rest from everywhere.
    alone = np.isin(label, label[seeds]) & (np.bincount(label)[label] > 1)
    sides = np.unique(np.sort(edges(faces), axis=1), axis=0)
    ways = np.concatenate([sides, sides[:, ::-1]])
    along = border_edges[alone[border_edges[:, 0]]]
    ways = np.concatenate([ways[~alone[ways[:, 1]]], along, along[:, ::-1]])
    start, end = ways.T
    length = np.linalg.norm(places[start] - places[end], axis=1).astype(np.float64) + 1e-12
    graph = csr_array((length, (start, end)), (count, count))
    owner = dijkstra(graph, indices=seeds, return_predecessors=True, min_only=True)[2]
    return np.maximum(owner, -1).astype(np.int64)


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
