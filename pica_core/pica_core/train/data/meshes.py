"""The meshes of a capture: tracked ones, exact ones, and both as the maps that encoders see.

A *dense* mesh is of the capture's topology, a *tracked* one of the tracker's, which has some of
the dense one's vertices, or all. The best meshes there are: exact ones; without them the tracked
ones.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from pica_core.avatar.spec import MAP_SIZE
from pica_core.avatar.variants import TopologyName
from pica_core.camera import Camera
from pica_core.capture.dataset.dataset import Capture, Topology
from pica_core.model.decoders import sample_map
from pica_core.train.config import MeshSource
from pica_core.train.raster import Rasteriser
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
    take the nearest covered texel.
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
        ids = rasteriser.triangle_ids(flat[None], [camera])[0]
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
    index = np.cumsum(covered).reshape(covered.shape) - 1
    nearest = distance_transform_edt(~covered, return_distances=False, return_indices=True)
    return UvRaster(covered, corners[covered], weights[covered], index[tuple(nearest)].reshape(-1))


def _texel_weights(texel_uv: FloatArray, corners: Int64Array, texels: Int64Array) -> FloatArray:
    """Barycentric weights ``[M, 3]`` of texel centres (rows, columns) in their triangles."""
    a, b, c = (texel_uv[corners[:, i]] for i in range(3))
    point = texels[:, ::-1] + 0.5
    opposite = ((b - point, c - point), (c - point, a - point), (a - point, b - point))
    areas = np.stack([p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in opposite], 1)
    weights: FloatArray = (areas / areas.sum(1, keepdims=True)).astype(np.float32)
    return weights


IMPORTANT_REGIONS = ("mouth", "lips", "eyes", "eyeballs", "lids", "teeth", "tongue")
"""Vertex regions of a capture's topology that are small on the map and large to the eye."""
MAX_MAPS = 2048
"""Maps of meshes kept in memory, 0.8 MB each; the least recently used go first."""


class CaptureMeshes:
    """All meshes of a capture, in memory; lengths in metres, means over training frames.

    Attributes:
        source: What encoder and mesh loss are given: exact meshes, or the tracker's.
        tracked_m: Tracked meshes, ``[T, Vt, 3]``.
        dense_m: The best dense meshes, ``[T, V, 3]``.
        tracked_mean_m: Mean of the tracked meshes over the training frames, ``[Vt, 3]``.
        dense_mean_m: Mean of the dense meshes over the training frames, ``[V, 3]``.
        position_mean: The dense mean as a map, ``[S, S, 3]``.
        position_scale_m: Unit of offsets from the mean: twice their root mean square.
    """

    def __init__(self, capture: Capture, train_frames: list[int]) -> None:
        self._capture, self._train_frames = capture, train_frames
        dense, tracked = capture.topology, capture.tracked_topology
        index = capture.dense_vertex
        self._dense_vertex = np.arange(len(dense.vertex_uv)) if index is None else index
        self.uv_raster = rasterise_uv(dense.vertex_uv, dense.faces, MAP_SIZE)
        self._tracked_raster = self.uv_raster
        if tracked is not dense:
            self._tracked_raster = rasterise_uv(tracked.vertex_uv, tracked.faces, MAP_SIZE)
        frames = capture.frames
        self.tracked_m = np.stack([capture.vertices_m(frame) for frame in frames])
        self.tracked_mean_m: FloatArray = self.tracked_m[train_frames].mean(0)
        self.dense_m = self.tracked_m
        if capture.has_truth:
            self.dense_m = np.stack([capture.true_vertices_m(frame) for frame in frames])
        train = self.dense_m[train_frames]
        self.dense_mean_m: FloatArray = train.mean(0, dtype=np.float64).astype(np.float32)
        self.position_mean = self.uv_raster.position_map(self.dense_mean_m)
        self.position_scale_m = float(np.sqrt(np.square(train - self.dense_mean_m).mean()) * 2)
        self.source: MeshSource = "truth" if capture.has_truth else "tracked"
        self._map = lru_cache(MAX_MAPS)(self._map_of)

    def use(self, source: MeshSource) -> bool:
        """Choose what encoder and mesh loss are given: exact meshes or the tracker's. Return True
        if the capture has them; without exact meshes it stays at the tracked ones."""
        self.source = source if self._capture.has_truth else "tracked"
        return self.source == source

    def topology(self, name: TopologyName) -> Topology:
        """The topology that a model calls "dense" or "tracked"."""
        capture = self._capture
        return capture.topology if name == "dense" else capture.tracked_topology

    def tracked_position_mean(self) -> FloatArray:
        """The mean of the tracked topology's meshes as a map, ``[S, S, 3]``."""
        return self._tracked_raster.position_map(self.dense_mean_m[self._dense_vertex])

    def neutral_m(self, name: TopologyName, arkit: Tensor) -> FloatArray:
        """The mesh of the training frame nearest to a neutral expression, as `source` says:
        ``[V, 3]``.

        Args:
            arkit: Expressions of all frames, ``[T, 52]``; where a capture has none the frame
                nearest to the mean mesh is taken.
        """
        if self._capture.has_expressions:
            away = arkit[self._train_frames].square().sum(1).numpy()
        else:
            offsets = self.tracked_m[self._train_frames] - self.tracked_mean_m
            away = np.square(offsets).sum((1, 2))
        frame = self._train_frames[int(away.argmin())]
        return self.best_tracked(frame) if name == "tracked" else self.best_dense(frame)

    def true_at_tracked(self, frame: int) -> FloatArray:
        """The best mesh at the vertices of the tracked topology, ``[Vt, 3]``."""
        mesh: FloatArray = self.dense_m[frame, self._dense_vertex]
        return mesh

    def best_dense(self, frame: int) -> FloatArray:
        """The mesh of the dense topology that `source` has, ``[V, 3]``: a tracked one through its
        position map where it has fewer vertices."""
        if self.source == "truth" or self._tracked_raster is self.uv_raster:
            mesh: FloatArray = (
                self.dense_m[frame] if self.source == "truth" else self.tracked_m[frame]
            )
            return mesh
        values = torch.from_numpy(self._tracked_raster.position_map(self.tracked_m[frame]))
        uv = torch.from_numpy(np.ascontiguousarray(self._capture.topology.vertex_uv, np.float32))
        found = sample_map(values.permute(2, 0, 1)[None], uv)[0]
        return found.contiguous().numpy()

    def best_tracked(self, frame: int) -> FloatArray:
        """The same of the tracked topology, ``[Vt, 3]``."""
        if self.source == "tracked":
            mesh: FloatArray = self.tracked_m[frame]
            return mesh
        return self.true_at_tracked(frame)

    def dense(self, frames: list[int]) -> Tensor:
        """The best dense meshes there are, ``[N, V, 3]``."""
        return torch.from_numpy(self.dense_m[frames])

    def tracked(self, frames: list[int]) -> Tensor:
        """Meshes of the tracked topology, ``[N, Vt, 3]``: as the tracker found them, or the best
        surface there is at its vertices, as `source` says."""
        return torch.from_numpy(np.stack([self.best_tracked(frame) for frame in frames]))

    def position_maps(self, frames: list[int]) -> Tensor:
        """What encoders see of a frame's shape: offsets from the mean, in position scales, as maps
        ``[N, 3, S, S]``; of the meshes that `source` names."""
        maps = np.stack([self._map(frame, self.source) for frame in frames])
        return torch.from_numpy(maps).permute(0, 3, 1, 2).contiguous()

    def _map_of(self, frame: int, source: MeshSource) -> FloatArray:
        if source == "tracked":
            offset, raster = self.tracked_m[frame] - self.tracked_mean_m, self._tracked_raster
        else:
            offset, raster = self.dense_m[frame] - self.dense_mean_m, self.uv_raster
        return raster.position_map(offset / self.position_scale_m)


def important_vertices(topology: Topology) -> BoolArray:
    """Which vertices are of `IMPORTANT_REGIONS`. bool ``[V]``."""
    important: BoolArray = np.logical_or.reduce([topology.region(n) for n in IMPORTANT_REGIONS])
    return important


def vertex_importance(
    topology: Topology, region_weight: float = 4.0, lid_weight: float = 16.0
) -> FloatArray:
    """How much an error of each vertex counts: mouth and eyes above the rest, lids most. ``[V]``"""
    weights = {**dict.fromkeys(IMPORTANT_REGIONS, region_weight), "lids": lid_weight}
    return topology.by_region(weights, 1.0).astype(np.float32)
