"""What a tracker gives of a head: a mesh of some 7,000 vertices, a little off, and its pose.

Seeds are spread over the surface by farthest-point choice, denser where faces move and look; every
dense vertex joins the seed that is nearest along the surface, and wherever three such patches meet
there is a triangle (the dual of a Voronoi diagram on the mesh). The result is a subset of the
dense vertices with their UVs, so the exact position of a tracked vertex is always known. Both sides
of a UV seam keep the same seeds, and vertices of a border or slit join seeds of their border only,
so lips and lids keep their slits and seams do not open. Unlike the paper's (section 3), the mesh
has teeth, tongue and the inside of the mouth.

A smooth error over the face drifts with time: part of it stays for the whole capture (a template
that does not quite fit), the rest wanders over half a second. Errors along the surface are larger
than across it: images hold a surface better than they hold its sliding. Amounts by region are in
`SPREAD_MM`; they are chosen, not measured on a tracker.
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial.transform import Rotation

from pica_core.capture.dataset.files import Topology
from pica_core.capture.triangles import edges, vertex_normals
from pica_core.types import BoolArray, Float64Array, FloatArray, Int64Array

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
    return topology.part(chosen, renamed.reshape(-1, 3).astype(np.int32)), chosen


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


WAVES = 3
"""Waves in a signal: one is a sine, many are near a Gaussian process."""
FIELD_WAVES = 48


def smooth_signals(
    random: np.random.Generator, count: int, scale_s: float, time_s: float
) -> Float64Array:
    """Signals of about unit variance, which change over `scale_s`, at a moment. ``[count]``."""
    frequency = random.normal(0.0, 1.0 / scale_s, (WAVES, count))
    phase = random.uniform(0.0, 2 * np.pi, (WAVES, count))
    return np.cos(frequency * time_s + phase).sum(axis=0) * np.sqrt(2.0 / WAVES)


SPREAD_MM: dict[str, float] = {
    "hair": 0.32,
    "collar": 0.32,
    "neck": 0.24,
    "scalp": 0.24,
    "ears": 0.2,
    "face": 0.12,
    "eyeballs": 0.16,
    "lids": 0.18,
    "lips": 0.18,
}
"""Standard deviation of the smooth error along each axis, mm; the last region that applies counts,
elsewhere `ELSEWHERE_MM`."""
ELSEWHERE_MM = 0.2
FIELD_SCALE_M = 0.018
"""Distance over which the error changes."""
DRIFT_S = 0.5
"""Time over which it changes."""
LASTING_SHARE = 0.35
"""Share of the variance that stays through the capture."""
ACROSS = 0.5
"""How much of the error across the surface is left."""
LIMIT_MM = 0.98
"""No vertex is farther off than this."""


class SimulatedTracker:
    """A tracker's errors on one mesh, given at rest, metres ``[Vt, 3]``.

    Vertices with the same number in `places` ``[Vt]`` are one point, and stay together.
    """

    def __init__(
        self, topology: Topology, rest_m: FloatArray, seed: int, places: Int64Array
    ) -> None:
        random = np.random.default_rng([seed, 0x7AC4])
        self._seed = seed
        direction = random.normal(0.0, 1.0 / FIELD_SCALE_M, (3, FIELD_WAVES))
        phase = random.uniform(0.0, 2 * np.pi, FIELD_WAVES)
        waves = np.cos(rest_m.astype(np.float64) @ direction + phase)
        self._field = np.sqrt(2.0 / FIELD_WAVES) * waves
        self._lasting = random.normal(size=3 * FIELD_WAVES)
        self._faces = topology.faces
        _, first, number = np.unique(places, return_index=True, return_inverse=True)
        self._one_point = first[number.reshape(-1)]
        self._spread_m = 0.001 * topology.by_region(SPREAD_MM, ELSEWHERE_MM)[:, None]

    def follow(self, exact_m: FloatArray, take: int, time_s: float) -> FloatArray:
        """What the tracker says of its vertices, which are at `exact_m`: metres, ``[Vt, 3]``."""
        random = np.random.default_rng([self._seed, 0x7AC5, take])
        drift = smooth_signals(random, 3 * FIELD_WAVES, DRIFT_S, time_s)
        strengths = np.sqrt(LASTING_SHARE) * self._lasting + np.sqrt(1 - LASTING_SHARE) * drift
        error = self._field @ strengths.reshape(-1, 3) * self._spread_m
        normals = vertex_normals(exact_m, self._faces)
        error -= (1 - ACROSS) * (error * normals).sum(axis=1, keepdims=True) * normals
        limit = 0.001 * LIMIT_MM
        error *= limit / np.sqrt(limit**2 + (error**2).sum(axis=1, keepdims=True))
        return (exact_m + error[self._one_point]).astype(np.float32)


TURN_DEG = (2.5, 3.5, 1.5)
"""Standard deviations of nodding, turning and tilting, degrees (chosen: a seated speaker)."""
SHIFT_M = (0.006, 0.003, 0.006)
"""Standard deviations along x, y and z, metres (chosen)."""
PIVOT_M = (0.0, -0.09, -0.015)
"""What the head turns about: the top of the neck, head frame."""
LIMIT = 2.0
"""Signals are held within so many standard deviations."""


class Motion(NamedTuple):
    """How much a head moves, against a seated speaker's, and the time over which it does."""

    reach: float = 1.0
    scale_s: float = 0.9


SEATED = Motion()


def head_to_world(seed: int, take: int, time_s: float, motion: Motion = SEATED) -> Float64Array:
    """A head's pose in a take of a capture, by the capture's seed and the take's number.

    Returns:
        Rotation and translation (metres) from head frame to world. float64 ``[3, 4]``.
    """
    random = np.random.default_rng([seed, 0x4EAD, take])
    signals = smooth_signals(random, 6, motion.scale_s, time_s)
    values = motion.reach * LIMIT * np.tanh(signals / LIMIT)
    rotation = Rotation.from_rotvec(np.radians(TURN_DEG) * values[:3]).as_matrix()
    pivot = np.array(PIVOT_M)
    shift = pivot - rotation @ pivot + SHIFT_M * values[3:]
    return np.concatenate([rotation, shift[:, None]], axis=1)
