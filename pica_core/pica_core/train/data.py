"""A capture as tensors: meshes and textures in memory, images on demand, batches by step number.

Every random choice of step n comes from a generator seeded with (seed, n), so a resumed run draws
what an uninterrupted one would have drawn.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from pica_core.camera import Camera
from pica_core.capture.dataset import Capture
from pica_core.errors import CaptureError
from pica_core.train.rasterise import Rasteriser

FloatArray = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]
IMPORTANT_REGIONS = ("mouth", "lips", "eyes", "eyeballs", "lids", "teeth", "tongue")
"""Vertex regions of a capture's topology that are small on the map and large to the eye."""
MAX_RARITY = 8.0
"""Limit of a frame's weight against the usual one (chosen: a full blink reaches 7)."""
TEXEL_TOLERANCE = 1e-2
"""How far from a texel centre a vertex may lie to own the texel, texels."""
IMAGE_CACHE_BYTES = 4 << 30
"""Decoded images kept in memory; the least recently used go first."""


@dataclass(frozen=True, slots=True)
class UvRaster:
    """Where each texel of a map lies on the mesh: `corners` int64 ``[M, 3]``, `weights` ``[M, 3]``.

    `covered` bool ``[256, 256]`` says which M texels those are; `nearest` int64 ``[256 * 256]``
    gives the covered texel (as an index into M) that fills each texel outside the charts.
    """

    covered: npt.NDArray[np.bool_]
    corners: npt.NDArray[np.int64]
    weights: FloatArray
    nearest: npt.NDArray[np.int64]

    def position_map(self, vertices_m: FloatArray) -> FloatArray:
        """A mesh ``[V, 3]`` as a map ``[256, 256, 3]``, padded outwards from the charts."""
        values: FloatArray = (vertices_m[self.corners] * self.weights[:, :, None]).sum(1)
        size = len(self.covered)
        return values[self.nearest].reshape(size, size, 3).astype(np.float32, copy=False)


def rasterise_uv(vertex_uv: FloatArray, faces: npt.NDArray[np.int32], size: int) -> UvRaster:
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


def _texel_weights(
    texel_uv: FloatArray, corners: npt.NDArray[np.int64], texels: npt.NDArray[np.int64]
) -> FloatArray:
    """Barycentric weights ``[M, 3]`` of texel centres (rows, columns) in their triangles."""
    a, b, c = (texel_uv[corners[:, i]] for i in range(3))
    point = texels[:, ::-1] + 0.5
    opposite = ((b - point, c - point), (c - point, a - point), (a - point, b - point))
    areas = np.stack([p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in opposite], 1)
    weights: FloatArray = (areas / areas.sum(1, keepdims=True)).astype(np.float32)
    return weights


def _grow(covered: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """For each texel the index (among the covered ones) of a nearest covered texel."""
    index = np.full(covered.shape, -1, np.int64)
    index[covered] = np.arange(np.count_nonzero(covered))
    while (index < 0).any():
        before = index
        padded = np.pad(before, 1, constant_values=-1)
        for dy, dx in ((0, 1), (2, 1), (1, 0), (1, 2)):
            neighbour = padded[dy : dy + covered.shape[0], dx : dx + covered.shape[1]]
            index = np.where(index < 0, neighbour, index)
    return index.reshape(-1)


def rarity(offsets_m: FloatArray, regions: dict[str, npt.NDArray[np.bool_]]) -> Float64Array:
    """How far each frame's eyes or mouth lie from their mean, against the usual.

    Args:
        offsets_m: Vertices minus mean vertices, metres, ``[T, V, 3]``.
        regions: Named vertex sets, bool ``[V]`` each.

    Returns:
        The largest such ratio over `IMPORTANT_REGIONS`, from 1 to `MAX_RARITY`, float64 ``[T]``.
    """
    ratios = np.ones(len(offsets_m))
    for name in IMPORTANT_REGIONS:
        if name not in regions or not regions[name].any():
            continue
        part = offsets_m[:, regions[name]]
        distance = np.sqrt(np.square(part, dtype=np.float64).sum(2).mean(1))
        ratios = np.maximum(ratios, distance / max(float(distance.mean()), 1e-9))
    return np.minimum(ratios, MAX_RARITY)


class TrainingData:
    """The frames of a capture, ready for batches.

    Args:
        capture: The capture to read.
        map_size: Rows and columns of the position map.

    Raises:
        CaptureError: No training or no test frames.
    """

    def __init__(self, capture: Capture, map_size: int) -> None:
        self.capture = capture
        self.train_frames = [i for i, f in enumerate(capture.frames) if f.split == "train"]
        self.test_frames = [i for i, f in enumerate(capture.frames) if f.split == "test"]
        if not self.train_frames or not self.test_frames:
            raise CaptureError(
                f"{capture.path}: {len(self.train_frames)} training and {len(self.test_frames)} "
                "test frames; at least one of each is needed"
            )
        topology = capture.topology
        self.vertex_uv = torch.from_numpy(np.ascontiguousarray(topology.vertex_uv, np.float32))
        self.faces = torch.from_numpy(topology.faces.astype(np.int64))
        self.uv_raster = rasterise_uv(topology.vertex_uv, topology.faces, map_size)
        read_mesh = capture.true_vertices_m if capture.has_truth else capture.vertices_m
        self.vertices_m = np.stack([read_mesh(f) for f in capture.frames])
        train = self.vertices_m[self.train_frames]
        self.mean_vertices_m: FloatArray = train.mean(0, dtype=np.float64).astype(np.float32)
        self.position_mean = self.uv_raster.position_map(self.mean_vertices_m)
        self.position_scale_m = float(np.sqrt(np.square(train - self.mean_vertices_m).mean()) * 2)
        self.important = np.zeros(len(self.mean_vertices_m), bool)
        for name in IMPORTANT_REGIONS:
            if name in topology.regions:
                self.important |= topology.regions[name]
        self.lids = topology.regions.get("lids", np.zeros(len(self.important), bool))
        self.frame_weights = rarity(train - self.mean_vertices_m, topology.regions)
        self.arkit = torch.from_numpy(np.stack([capture.arkit(f) for f in capture.frames]))
        self._images: OrderedDict[tuple[int, str], npt.NDArray[np.uint8]] = OrderedDict()
        self._image_bytes = 0
        self._textures: dict[int, npt.NDArray[np.uint8]] = {}
        self._head_poses: dict[int, npt.NDArray[np.float64]] = {}
        self.camera_names = [camera.name for camera in capture.cameras]
        named = capture.info.get("evaluation_views", [])
        self.evaluation_views = [name for name in self.camera_names if name in named]
        if not self.evaluation_views:
            self.evaluation_views = self.camera_names

    def draw_frames(self, count: int, balance: float, rng: np.random.Generator) -> list[int]:
        """Draw training frames, with repetition, rare ones more often by the power `balance`."""
        weights = self.frame_weights**balance
        drawn: list[int] = rng.choice(self.train_frames, count, p=weights / weights.sum()).tolist()
        return drawn

    def textures(self, frames: list[int]) -> Tensor:
        """Average textures of frames, about [-1, 1], ``[N, 3, S, S]``."""
        for index in frames:
            if index not in self._textures:
                self._textures[index] = self.capture.average_texture(self.capture.frames[index])
        stacked = torch.from_numpy(np.stack([self._textures[index] for index in frames]))
        return stacked.permute(0, 3, 1, 2).to(torch.float32) / 127.5 - 1

    def position_maps(self, frames: list[int]) -> Tensor:
        """Tracked offsets from the mean, in position scales, as maps ``[N, 3, 256, 256]``."""
        offsets = (self.vertices_m[frames] - self.mean_vertices_m) / self.position_scale_m
        maps = np.stack([self.uv_raster.position_map(mesh) for mesh in offsets])
        return torch.from_numpy(maps).permute(0, 3, 1, 2).contiguous()

    def meshes(self, frames: list[int]) -> Tensor:
        """Tracked vertices in metres, ``[N, V, 3]``."""
        return torch.from_numpy(self.vertices_m[frames])

    def image(self, frame: int, camera: str) -> npt.NDArray[np.uint8]:
        """An image, through the cache; uint8 ``[H, W, 3]``."""
        key = (frame, camera)
        if key in self._images:
            self._images.move_to_end(key)
            return self._images[key]
        image = self.capture.image(self.capture.frames[frame], camera)
        self._images[key] = image
        self._image_bytes += image.nbytes
        while self._image_bytes > IMAGE_CACHE_BYTES:
            self._image_bytes -= self._images.popitem(last=False)[1].nbytes
        return image

    def camera(self, frame: int, name: str) -> Camera:
        """The camera of an image in the frame's head axes: head to camera."""
        camera = self.capture.camera(name)
        if frame not in self._head_poses:
            self._head_poses[frame] = self.capture.head_to_world(self.capture.frames[frame])
        pose = self._head_poses[frame]
        return replace(
            camera,
            rotation=camera.rotation @ pose[:, :3],
            translation_m=camera.rotation @ pose[:, 3] + camera.translation_m,
        )


def view_direction(camera: Camera) -> FloatArray:
    """From the head's origin to a camera in head axes, unit length, ``[3]``."""
    centre = camera.centre_m
    return (centre / np.linalg.norm(centre)).astype(np.float32)
