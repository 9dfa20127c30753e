"""Meshes as maps: which triangle lies under each texel of a UV layout."""

from dataclasses import dataclass

import numpy as np

from pica_core.camera import Camera
from pica_core.train.rasterise import Rasteriser
from pica_core.types import BoolArray, FloatArray, Int64Array, IntArray

TEXEL_TOLERANCE = 1e-2
"""How far from a texel centre a vertex may lie to own the texel, texels."""


@dataclass(frozen=True, slots=True)
class UvRaster:
    """Where each texel of a map lies on the mesh: `corners` int64 ``[M, 3]``, `weights` ``[M, 3]``.

    `covered` bool ``[256, 256]`` says which M texels those are; `nearest` int64 ``[256 * 256]``
    gives the covered texel (as an index into M) that fills each texel outside the charts.
    """

    covered: BoolArray
    corners: Int64Array
    weights: FloatArray
    nearest: Int64Array

    def position_map(self, vertices_m: FloatArray) -> FloatArray:
        """A mesh ``[V, 3]`` as a map ``[256, 256, 3]``, padded outwards from the charts."""
        values: FloatArray = (vertices_m[self.corners] * self.weights[:, :, None]).sum(1)
        size = len(self.covered)
        return values[self.nearest].reshape(size, size, 3).astype(np.float32, copy=False)


def rasterise_uv(vertex_uv: FloatArray, faces: IntArray, size: int) -> UvRaster:
    """Find the triangle and the weights of every texel centre of a ``[size, size]`` map.

    A vertex that lies on a texel centre owns that texel, also at the rim of a chart or of a slit,
    where a rasteriser may give the centre to neither side. Other texels that no triangle covers
    take the nearest covered texel, in steps of one texel.
    """
    flat = np.concatenate([vertex_uv, np.ones((len(vertex_uv), 1), np.float32)], 1)
    camera = Camera(
        name="uv",
        intrinsics=np.diag([float(size), float(size), 1.0]),
        rotation=np.eye(3),
        translation_m=np.zeros(3),
        width=size,
        height=size,
    )
    both_sides = np.concatenate([faces, faces[:, ::-1]])
    with Rasteriser(both_sides, len(flat)) as rasteriser:
        ids = rasteriser.triangle_ids(flat, camera)
    covered = ids >= 0
    corners = np.zeros((size, size, 3), np.int64)
    corners[covered] = both_sides[ids[covered]]
    weights = np.zeros((size, size, 3), np.float32)
    weights[covered] = _texel_weights(vertex_uv * size, corners[covered], np.argwhere(covered))
    texel = vertex_uv * size - 0.5
    nearest = np.rint(texel).astype(np.int64)
    owners = np.flatnonzero(np.abs(texel - nearest).max(1) < TEXEL_TOLERANCE)
    columns, rows = nearest[owners].T
    covered[rows, columns] = True
    corners[rows, columns] = owners[:, None]
    weights[rows, columns] = (1, 0, 0)
    return UvRaster(covered, corners[covered], weights[covered], _grow(covered))


def _texel_weights(texel_uv: FloatArray, corners: Int64Array, texels: Int64Array) -> FloatArray:
    """Barycentric weights ``[M, 3]`` of texel centres (rows, columns) in their triangles."""
    a, b, c = (texel_uv[corners[:, i]] for i in range(3))
    point = texels[:, ::-1] + 0.5
    opposite = ((b - point, c - point), (c - point, a - point), (a - point, b - point))
    areas = np.stack([p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in opposite], 1)
    weights: FloatArray = (areas / areas.sum(1, keepdims=True)).astype(np.float32)
    return weights


def _grow(covered: BoolArray) -> Int64Array:
    """Give each texel the index, among the covered ones, of a nearest covered texel."""
    index = np.full(covered.shape, -1, np.int64)
    index[covered] = np.arange(np.count_nonzero(covered))
    while (index < 0).any():
        before = index
        padded = np.pad(before, 1, constant_values=-1)
        for dy, dx in ((0, 1), (2, 1), (1, 0), (1, 2)):
            neighbour = padded[dy : dy + covered.shape[0], dx : dx + covered.shape[1]]
            index = np.where(index < 0, neighbour, index)
    return index.reshape(-1)
