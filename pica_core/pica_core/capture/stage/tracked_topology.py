"""The mesh that a tracker would follow: some 7,000 of the dense vertices.

Seeds are spread over the surface by farthest-point choice, denser where faces move and look; every
dense vertex joins the seed that is nearest along the surface, and wherever three such patches meet
there is a triangle (the dual of a Voronoi diagram on the mesh). The result is a subset of the
dense vertices with their UVs, so the exact position of a tracked vertex is always known.

Both sides of a UV seam keep the same seeds, and vertices of a border or slit join seeds of their
border only, so lips and lids keep their slits and seams do not open.

Unlike the paper's (section 3), the mesh has teeth, tongue and the inside of the mouth.
"""

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from pica_core.capture.dataset.files import Topology
from pica_core.capture.triangles import edges
from pica_core.types import BoolArray, FloatArray, Int64Array

NUM_VERTICES = 7000
"""Vertices that are aimed at (paper: 5K; the published Multiface meshes have 7,306)."""
DENSITY: dict[str, float] = {
    "hair": 0.6,
    "scalp": 0.6,
    "neck": 0.6,
    "collar": 0.45,
    "ears": 0.8,
    "face": 1.2,
    "mouth": 1.6,
    "mouth_interior": 0.5,
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
        shapes_m: It in a few expressions that open what is closed at rest, metres. ``[K, V, 3]``.
        num_vertices: How many to aim at; a mesh that has no more stays whole.
    """
    places = np.concatenate(list(np.asarray(shapes_m, np.float32)), axis=1)
    faces = topology.faces.astype(np.int64)
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
        regions={name: mask[chosen] for name, mask in topology.regions.items()},
    )
    return tracked, chosen


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
