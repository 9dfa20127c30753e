"""What the capture rooms ask of triangle meshes: areas, edges, normals, samples and pieces."""

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from pica_core.types import Array, Float64Array, FloatArray, Int64Array, IntArray

UNFOLDING, LEAST_COSINE = 24, 0.5
"""Steps in which `unfolded` goes back, where triangles turn by more than this cosine."""


def edges(faces: Array) -> Array:
    """Both ends of the three sides of each triangle, in its direction. ``[3 F, 2]``."""
    return faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def face_normals(points: Array, faces: Array) -> Array:
    """Normals of triangles in space, as long as twice their area. ``[F, 3]``."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def areas(points: Array, faces: Array) -> Array:
    """Areas of triangles in space. ``[F]``."""
    return 0.5 * np.linalg.norm(face_normals(points, faces), axis=1)


def signed_areas(points: Array, faces: Array) -> Array:
    """Areas of triangles in the plane, negative where they run clockwise. ``[F]``."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    cross = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1])
    return 0.5 * (cross - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]))


def vertex_normals(points: FloatArray, faces: IntArray) -> Float64Array:
    """Unit normals of vertices, area weighted; 0 where no face is. float64 ``[V, 3]``."""
    across = np.repeat(face_normals(points.astype(np.float64), faces), 3, axis=0)
    sums = [np.bincount(faces.ravel(), across[:, axis], len(points)) for axis in range(3)]
    total = np.stack(sums, 1)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-20)


def spread_samples(count: Int64Array) -> tuple[Int64Array, Float64Array, Float64Array]:
    """So many samples of each triangle, spread evenly: triangle and two barycentric weights.

    The weights follow the R2 sequence (Roberts 2018), folded into the triangle.
    """
    which = np.repeat(np.arange(len(count)), count)
    order = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    u = (0.5 + order * 0.7548776662466927) % 1.0
    v = (0.5 + order * 0.5698402909980532) % 1.0
    fold = u + v > 1
    return which, np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)


def components(faces: Array, count: int) -> Int64Array:
    """Label of each vertex's connected component. int64 ``[count]``."""
    start, end = edges(faces).T
    graph = coo_array((np.ones(len(start), np.bool_), (start, end)), (count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def edge_neighbours(faces: IntArray) -> tuple[Int64Array, Int64Array]:
    """Pairs of faces that share an edge. ``[n]`` each."""
    sides, owner = np.sort(edges(faces), axis=1), np.repeat(np.arange(len(faces)), 3)
    order = np.lexsort((sides[:, 1], sides[:, 0]))
    sides, owner = sides[order], owner[order]
    same = (sides[1:] == sides[:-1]).all(1)
    return owner[:-1][same], owner[1:][same]


def face_neighbours(faces: IntArray) -> tuple[Int64Array, Int64Array, Int64Array]:
    """Faces that have neighbours, where each one's neighbours begin in a list, and the list."""
    first, second = edge_neighbours(faces)
    own, other = np.concatenate([first, second]), np.concatenate([second, first])
    sort = np.argsort(own, kind="stable")
    with_some, start = np.unique(own[sort], return_index=True)
    return with_some, start, other[sort]


def mean_of_neighbours(faces: IntArray, count: int) -> csr_array:
    """What makes of each vertex's values the mean of those around it. ``[count, count]``."""
    start, end = edges(faces).T
    ends = np.concatenate([start, end]), np.concatenate([end, start])
    beside = coo_array((np.ones(len(ends[0])), ends), (count, count)).tocsr()
    num_around = np.diff(beside.indptr)
    beside.data = 1.0 / np.repeat(num_around, num_around)
    return beside


def nearest(points: Array, others: Array) -> tuple[Int64Array, Float64Array]:
    """The nearest of `others` to each point, and how far it is."""
    distance, index = KDTree(others).query(points)
    return index, distance


def unfolded(rest: Float64Array, moved: Float64Array, faces: IntArray) -> Float64Array:
    """Places moved away from others ``[V, 3]``, but less far where triangles would turn over."""
    here = faces[np.abs(moved - rest)[faces].max((1, 2)) > 1e-6]
    before = face_normals(rest, here)
    keep = np.ones(len(rest))
    for _ in range(UNFOLDING):
        points = rest + (moved - rest) * keep[:, None]
        now = face_normals(points, here)
        lengths = np.linalg.norm(now, axis=1) * np.linalg.norm(before, axis=1)
        folds = here[(now * before).sum(1) < LEAST_COSINE * lengths]
        if not len(folds):
            break
        keep[np.unique(folds)] *= 0.8
        mean = keep[here].mean(1)
        total = np.bincount(here.ravel(), np.repeat(mean, 3), len(rest))
        count = np.bincount(here.ravel(), minlength=len(rest))
        keep = np.minimum(keep, np.where(count > 0, total / np.maximum(count, 1), 1.0))
    return points
