"""Triangle meshes: areas, edges, normals, samples, pieces, and what can be seen of them.

What is seen is found by sampling the surface into coarse depth maps, without a GPU: once per rig,
to give texels to what cameras see, and to find the eye openings in a front view.
"""

from dataclasses import dataclass

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


def components(faces: Array, count: int) -> Int64Array:
    """Label of each vertex's connected component. int64 ``[count]``."""
    start, end = edges(faces).T
    graph = coo_array((np.ones(len(start), np.bool_), (start, end)), (count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def face_neighbours(faces: IntArray) -> tuple[Int64Array, Int64Array, Int64Array]:
    """Faces that share an edge with others, where each one's neighbours begin in a list, and the
    list."""
    sides, owner = np.sort(edges(faces), axis=1), np.repeat(np.arange(len(faces)), 3)
    order = np.lexsort((sides[:, 1], sides[:, 0]))
    sides, owner = sides[order], owner[order]
    same = (sides[1:] == sides[:-1]).all(1)
    first, second = owner[:-1][same], owner[1:][same]
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


CELL_M = 0.003
"""Cells of the depth maps for `visibility`."""
MAX_COLUMNS = 1_000
"""Of such a map, and as many rows; above 3 m cells grow (chosen: shapes may throw vertices metres
away)."""
FRONT_CELL_M = 0.0005
"""Cells of `FrontView`."""
SAMPLES_PER_CELL = 4.0
TOLERANCE_M = 0.004
"""How far behind the nearest sample a triangle may lie and still count as seen."""
MAX_SEEN = 500_000
"""Samples of a mesh for `visibility`; above 1.1 m^2 cells and what lies between samples grow
(chosen: heads take 60,000; 3 s of processor time)."""
FRONT_M = 0.3
"""How far to each side of the head's origin a `FrontView` reaches."""
MAX_SAMPLES = 2_000_000
"""Samples of a mesh at most (measured: a `FrontView` of a head takes 0.6 to 0.7 million; chosen:
250 MB on the way)."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FrontView:
    """The mesh from straight ahead: nearest face per cell, -1 where empty. int64 ``[R, C]``.

    Row 0 is the lowest y; `origin_m` is the corner of the first cell.
    """

    face: Int64Array
    depth_m: Float64Array
    origin_m: Float64Array

    def nearest_z(self, points: Float64Array) -> Float64Array:
        """Height z of the surface that is seen at these x and y; -inf beside it. ``[n]``."""
        cell = ((points[:, :2] - self.origin_m) / FRONT_CELL_M).astype(np.int64)
        rows, columns = self.face.shape
        inside = ((cell >= 0) & (cell < [columns, rows])).all(1)
        cell = np.clip(cell, 0, [columns - 1, rows - 1])
        return np.where(inside, self.depth_m[cell[:, 1], cell[:, 0]], -np.inf)


def samples(
    points: Float64Array, faces: IntArray, spacing: float
) -> tuple[Int64Array, Float64Array]:
    """Points spread evenly over triangles: face ``[n]`` and barycentric weights ``[n, 3]``.

    The weights follow the R2 sequence (Roberts 2018), folded into the triangle.
    """
    count = np.ceil(areas(points, faces) / spacing**2) + 1
    count = np.maximum(count * min(1.0, MAX_SAMPLES / count.sum()), 1).astype(np.int64)
    which = np.repeat(np.arange(len(count)), count)
    order = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    u = (0.5 + order * 0.7548776662466927) % 1.0
    v = (0.5 + order * 0.5698402909980532) % 1.0
    fold = u + v > 1
    u, v = np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)
    return which, np.stack([1 - u - v, u, v], 1)


def front_view(points: Float64Array, faces: IntArray) -> FrontView:
    """Draw what is around the head's origin from straight ahead, orthographically, in cells of
    `FRONT_CELL_M`."""
    lowest = np.maximum(points[:, :2].min(0), -FRONT_M)
    highest = np.maximum(np.minimum(points[:, :2].max(0), FRONT_M), lowest)
    corner = points[faces, :2]
    is_near = ((corner.max(1) >= lowest) & (corner.min(1) <= highest)).all(1)
    # Coarse triangles need samples by area, hidden ones none: what faces away is left out.
    ahead = np.flatnonzero(is_near & (face_normals(points, faces)[:, 2] > 0))
    which, weights = samples(points, faces[ahead], FRONT_CELL_M / 1.6)
    at = np.einsum("nk,nkc->nc", weights, points[faces[ahead[which]]])
    is_near = ((at[:, :2] >= lowest) & (at[:, :2] <= highest)).all(1)
    which, at = which[is_near], at[is_near]
    origin = lowest - FRONT_CELL_M
    size = np.ceil((highest - origin) / FRONT_CELL_M).astype(np.int64) + 1
    cell = ((at[:, :2] - origin) / FRONT_CELL_M).astype(np.int64)
    flat = cell[:, 1] * size[0] + cell[:, 0]
    order = np.argsort(at[:, 2], kind="stable")  # the nearest sample is written last
    face = np.full(size[0] * size[1], -1, np.int64)
    depth = np.full(size[0] * size[1], -np.inf)
    face[flat[order]] = ahead[which[order]]
    depth[flat[order]] = at[order, 2]
    shape = (int(size[1]), int(size[0]))
    return FrontView(face=face.reshape(shape), depth_m=depth.reshape(shape), origin_m=origin)


def _directions() -> Float64Array:
    """Towards cameras of the dome: 80 degrees to each side, 40 up and down."""
    grid = [(a, e) for e in (-38, -12, 14, 40) for a in (-78, -46, -16, 16, 46, 78)]
    azimuth, elevation = np.radians(np.array(grid, np.float64)).T
    ring = np.cos(elevation)
    return np.stack([np.sin(azimuth) * ring, np.sin(elevation), np.cos(azimuth) * ring], 1)


def visibility(poses: list[Float64Array], faces: IntArray) -> Float64Array:
    """How much of each triangle the dome sees: the best of several poses in metres. ``[F]``.

    That is the mean over cameras of the cosine to the camera where it sees it, 0 to about 0.6.
    """
    best = np.zeros(len(faces))
    spacing = max(
        CELL_M / np.sqrt(SAMPLES_PER_CELL), np.sqrt(areas(poses[0], faces).sum() / MAX_SEEN)
    )
    which, weights = samples(poses[0], faces, spacing)
    for points in poses:
        corner = points[faces]
        normal = face_normals(points, faces)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-20)
        at = np.einsum("nk,nkc->cn", weights, corner[which])
        places = [np.ascontiguousarray(each) for each in (at, points.T, corner.mean(1).T)]
        total = np.zeros(len(faces))
        directions = _directions()
        for direction in directions:
            right = np.cross([0.0, 1.0, 0.0], direction)
            right /= np.linalg.norm(right)
            basis = np.stack([right, np.cross(direction, right), direction])
            # Not `@`: the threads of BLAS make a product so thin take ten times as long.
            sample, low, middle = (np.einsum("ck,kn->cn", basis, each) for each in places)
            start, size_m = low[:2].min(1, keepdims=True), np.ptp(low[:2], axis=1)
            cell_m = max(spacing * np.sqrt(SAMPLES_PER_CELL), size_m.max() / MAX_COLUMNS)
            columns, rows = (size_m / cell_m).astype(np.int64) + 2
            cell, own = (
                tuple(((each[:2] - start) / cell_m).astype(np.int64)) for each in (sample, middle)
            )
            nearest = np.full((columns, rows), -np.inf)
            np.maximum.at(nearest, cell, sample[2])
            seen = middle[2] >= nearest[own] - TOLERANCE_M
            total += np.maximum(normal @ direction, 0.0) * seen
        best = np.maximum(best, total / len(directions))
    return best
