"""A capture as tensors: meshes in memory, images and textures through a cache of bounded size.

Every random choice of step n comes from a generator seeded with (seed, n), so a resumed run draws
what an uninterrupted one would have drawn.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.variants import TopologyName
from pica_core.camera import Camera
from pica_core.capture.dataset import multiface
from pica_core.capture.dataset.dataset import Capture, Topology
from pica_core.capture.dataset.reader import CaptureReader, Request
from pica_core.errors import CaptureError
from pica_core.model.decoders import sample_map
from pica_core.model.encoder import resize_texture
from pica_core.train.rasterise import Rasteriser
from pica_core.types import Float64Array, FloatArray

IMPORTANT_REGIONS = ("mouth", "lips", "eyes", "eyeballs", "lids", "teeth", "tongue")
"""Vertex regions of a capture's topology that are small on the map and large to the eye."""
MeshSource = Literal["truth", "tracked"]
MAX_RARITY = 8.0
"""Limit of a frame's weight against the usual one (chosen: a full blink reaches 7)."""
TEXEL_TOLERANCE = 1e-2
"""How far from a texel centre a vertex may lie to own the texel, texels."""
IMAGE_CACHE_BYTES = 4 << 30
"""Decoded images, depth and textures kept in memory; the least recently used go first."""
MAX_MAPS = 2048
"""Position maps and resized textures kept in memory, each; 0.8 MB a map or texture of 256 x 256."""


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


def spaced(frames: list[int], count: int) -> list[int]:
    """At most `count` of some frames, evenly spaced."""
    return frames[:: -(-len(frames) // count)] if count else []


def important_vertices(topology: Topology) -> npt.NDArray[np.bool_]:
    """Vertices of `IMPORTANT_REGIONS`. bool ``[V]``."""
    important = np.zeros(len(topology.vertex_uv), bool)
    for name in IMPORTANT_REGIONS:
        if name in topology.regions:
            important |= topology.regions[name]
    return important


def _look_up(position_map: FloatArray, uv: FloatArray) -> FloatArray:
    """A map ``[S, S, 3]`` at UVs ``[V, 2]``, bilinear."""
    values = torch.from_numpy(position_map).permute(2, 0, 1)[None]
    found = sample_map(values, torch.from_numpy(np.ascontiguousarray(uv, np.float32)))[0]
    vertices: FloatArray = found.contiguous().numpy()
    return vertices


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
        self._read_meshes(map_size)
        train = self.vertices_m[self.train_frames]
        self.mean_vertices_m: FloatArray = train.mean(0, dtype=np.float64).astype(np.float32)
        self.position_mean = self.uv_raster.position_map(self.mean_vertices_m)
        self.position_scale_m = float(np.sqrt(np.square(train - self.mean_vertices_m).mean()) * 2)
        self.important = important_vertices(topology)
        self.frame_weights = rarity(train - self.mean_vertices_m, topology.regions)
        self.arkit = torch.zeros(len(capture.frames), NUM_ARKIT)
        if capture.has_expressions:
            self.arkit = torch.from_numpy(np.stack([capture.arkit(f) for f in capture.frames]))
        self.reader = CaptureReader(capture, IMAGE_CACHE_BYTES)
        self._textures: OrderedDict[tuple[int, int], Tensor] = OrderedDict()
        self._maps: OrderedDict[tuple[int, MeshSource], FloatArray] = OrderedDict()
        self._cameras_of: dict[int, tuple[str, ...]] = {}
        self._backgrounds: dict[str, FloatArray] = {}
        self._head_poses: dict[int, npt.NDArray[np.float64]] = {}
        self.camera_names = [camera.name for camera in capture.cameras]
        named = capture.info.get("evaluation_views", [])
        self.evaluation_views = [name for name in self.camera_names if name in named]
        if not self.evaluation_views:
            self.evaluation_views = self.camera_names

    def _read_meshes(self, map_size: int) -> None:
        """Read tracked and exact meshes.

        `vertices_m` are the best meshes of `topology` that there are: exact ones; without them the
        tracked ones, through their position maps where they are of another topology.
        """
        capture, frames = self.capture, self.capture.frames
        self.tracked_m = np.stack([capture.vertices_m(frame) for frame in frames])
        self.one_mesh = capture.tracked_topology is capture.topology
        self._tracked_raster = self.uv_raster
        if not self.one_mesh:
            tracked = capture.tracked_topology
            self._tracked_raster = rasterise_uv(tracked.vertex_uv, tracked.faces, map_size)
        self.tracked_mean_m: FloatArray = self.tracked_m[self.train_frames].mean(0)
        if capture.has_truth:
            self.vertices_m = np.stack([capture.true_vertices_m(frame) for frame in frames])
        elif self.one_mesh:
            self.vertices_m = self.tracked_m
        else:
            self.vertices_m = np.stack(
                [self._dense_of_tracked(index) for index in range(len(frames))]
            )
        self._true_tracked: dict[int, FloatArray] = {}
        self.mesh_source: MeshSource = "truth" if capture.has_truth else "tracked"

    def use_meshes(self, source: MeshSource) -> bool:
        """Choose what encoder and mesh loss are given: exact meshes or the tracker's.

        Returns:
            Whether the capture has them; without exact meshes it stays at the tracked ones.
        """
        self.mesh_source = source if self.capture.has_truth else "tracked"
        return self.mesh_source == source

    def _dense_of_tracked(self, frame: int) -> FloatArray:
        """The tracked mesh at the vertices of the dense topology, through its position map."""
        values = self._tracked_raster.position_map(self.tracked_m[frame])
        return _look_up(values, self.capture.topology.vertex_uv)

    def topology(self, name: TopologyName) -> Topology:
        """The topology that a model calls "dense" or "tracked"."""
        capture = self.capture
        return capture.topology if name == "dense" else capture.tracked_topology

    def tracked_position_mean(self) -> FloatArray:
        """The mean of the tracked topology's meshes as a map, metres, ``[S, S, 3]``."""
        mean = self.tracked_mean_m
        if self.capture.dense_vertex is not None:
            mean = self.mean_vertices_m[self.capture.dense_vertex]
        return self._tracked_raster.position_map(mean)

    def neutral_m(self, name: TopologyName) -> FloatArray:
        """The mesh of the training frame nearest to a neutral expression, on a topology, as
        `mesh_source` says; metres, ``[V, 3]``."""
        tracked = self.mesh_source == "tracked"
        frame = self._neutral_frame()
        if name == "tracked":
            return self.tracked_m[frame] if tracked else self.true_at_tracked(frame)
        if tracked and not self.one_mesh:
            return self._dense_of_tracked(frame)
        mesh: FloatArray = (self.tracked_m if tracked else self.vertices_m)[frame]
        return mesh

    def _neutral_frame(self) -> int:
        """The training frame nearest to a neutral expression; to the mean mesh, where expressions
        are unknown."""
        if self.capture.has_expressions:
            away = self.arkit[self.train_frames].square().sum(1).numpy()
        else:
            offsets = self.tracked_m[self.train_frames] - self.tracked_mean_m
            away = np.square(offsets).sum((1, 2))
        return self.train_frames[int(away.argmin())]

    def true_at_tracked(self, frame: int) -> FloatArray:
        """The best mesh at the vertices of the tracked topology, metres, ``[Vt, 3]``."""
        index = self.capture.dense_vertex
        if self.one_mesh or index is not None:
            mesh: FloatArray = self.vertices_m[frame]
            return mesh if index is None else mesh[index]
        if frame not in self._true_tracked:
            values = self.uv_raster.position_map(self.vertices_m[frame])
            self._true_tracked[frame] = _look_up(values, self.capture.tracked_topology.vertex_uv)
        return self._true_tracked[frame]

    def draw_frames(self, count: int, balance: float, rng: np.random.Generator) -> list[int]:
        """Draw training frames, with repetition, rare ones more often by the power `balance`."""
        weights = self.frame_weights**balance
        drawn: list[int] = rng.choice(self.train_frames, count, p=weights / weights.sum()).tolist()
        return drawn

    def textures(self, frames: list[int], size: int) -> Tensor:
        """Average textures of frames, about [-1, 1], ``[N, 3, size, size]``."""
        return torch.stack([self._texture_of(index, size) for index in frames])

    def _texture_of(self, frame: int, size: int) -> Tensor:
        key = frame, size
        if key not in self._textures:
            stored = torch.from_numpy(self.reader.read(Request("texture", frame)).copy())
            texture = stored.permute(2, 0, 1)[None].to(torch.float32) / 127.5 - 1
            self._textures[key] = resize_texture(texture, size)[0]
            if len(self._textures) > MAX_MAPS:
                self._textures.popitem(last=False)
        self._textures.move_to_end(key)
        return self._textures[key]

    def position_maps(self, frames: list[int]) -> Tensor:
        """What encoders see of a frame's shape: offsets from the mean, in position scales, as maps
        ``[N, 3, 256, 256]``; of the meshes that `mesh_source` names."""
        maps = np.stack([self._map_of(index) for index in frames])
        return torch.from_numpy(maps).permute(0, 3, 1, 2).contiguous()

    def _map_of(self, frame: int) -> FloatArray:
        """A frame's map for `position_maps`, ``[256, 256, 3]``."""
        key = frame, self.mesh_source
        if key not in self._maps:
            if self.mesh_source == "tracked":
                offset, raster = self.tracked_m[frame] - self.tracked_mean_m, self._tracked_raster
            else:
                offset, raster = self.vertices_m[frame] - self.mean_vertices_m, self.uv_raster
            self._maps[key] = raster.position_map(offset / self.position_scale_m)
            if len(self._maps) > MAX_MAPS:
                self._maps.popitem(last=False)
        self._maps.move_to_end(key)
        return self._maps[key]

    def meshes(self, frames: list[int]) -> Tensor:
        """The best dense meshes there are, in metres, ``[N, V, 3]``."""
        return torch.from_numpy(self.vertices_m[frames])

    def tracked_meshes(self, frames: list[int]) -> Tensor:
        """Meshes of the tracked topology in metres, ``[N, Vt, 3]``: as the tracker found them, or
        the best surface there is at its vertices, as `mesh_source` says."""
        if self.mesh_source == "tracked":
            return torch.from_numpy(self.tracked_m[frames])
        return torch.from_numpy(np.stack([self.true_at_tracked(frame) for frame in frames]))

    def depth_m(self, frame: int, camera: str) -> FloatArray | None:
        """Measured depth, 0 where unknown, float32 ``[H, W]``; None where the image has none."""
        if not self._has_depth(frame, camera):
            return None
        depth_m: FloatArray = self.reader.read(Request("depth", frame, camera))
        return depth_m

    def _has_depth(self, frame: int, camera: str) -> bool:
        where = self.capture.frames[frame]
        path = multiface.image_path("depth", where.segment, camera, where.name)
        return self.capture.has_depth and (self.capture.path / path).is_file()

    def background(self, frame: int, camera: str) -> FloatArray:
        """Colour of what is not the head: the median over the mask's empty pixels, 0 to 1, ``[3]``.

        Only a plain background is known so; a capture without masks gives black.
        """
        if camera not in self._backgrounds:
            colour = np.zeros(3, np.float32)
            where = self.capture.frames[frame]
            path = multiface.image_path("mask", where.segment, camera, where.name)
            if (self.capture.path / path).is_file():
                empty = self.capture.mask(where, camera) == 0
                if empty.any():
                    colour = np.median(self.image(frame, camera)[empty], axis=0) / 255
            self._backgrounds[camera] = colour.astype(np.float32)
        return self._backgrounds[camera]

    def image(self, frame: int, camera: str) -> npt.NDArray[np.uint8]:
        """An image; uint8 ``[H, W, 3]``.

        Raises:
            CaptureError: It cannot be read.
        """
        return self.reader.read(Request("image", frame, camera))

    def cameras_of(self, frame: int) -> tuple[str, ...]:
        """Cameras that have an image of a frame, of those that can be read as far as is known."""
        if frame not in self._cameras_of:
            self._cameras_of[frame] = self.capture.cameras_of(self.capture.frames[frame])
        return self._cameras_of[frame]

    def leave_out(self, frame: int, camera: str) -> None:
        """Ask for an image no more: it cannot be read.

        Raises:
            CaptureError: It was the last one of its frame.
        """
        rest = tuple(name for name in self.cameras_of(frame) if name != camera)
        if not rest:
            where = self.capture.frames[frame]
            raise CaptureError(
                f"{self.capture.path}: no image of {where.segment} {where.name} can be read"
            )
        self._cameras_of[frame] = rest

    def expect(self, images: list[tuple[int, str]], *, depth: bool) -> None:
        """Have images decoded while something else goes on."""
        self.reader.ask(Request("image", frame, camera) for frame, camera in images)
        if depth:
            self.reader.ask(
                Request("depth", frame, camera)
                for frame, camera in images
                if self._has_depth(frame, camera)
            )

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
