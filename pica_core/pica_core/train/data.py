"""A capture as tensors: its meshes, its images behind a cache, which frames are drawn (rare
expressions more often), and what it tells a model before training.

A *dense* mesh is of the capture's topology, a *tracked* one of the tracker's, which has some of
the dense one's vertices, or all. The best meshes there are: exact ones; without them the tracked
ones.
"""

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
import numpy.typing as npt
import torch
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.linear import fit_bases, split_bases
from pica_core.avatar.spec import MAP_SIZE, VARIANTS, TopologyName
from pica_core.camera import Camera
from pica_core.capture.dataset import multiface
from pica_core.capture.dataset.dataset import Capture
from pica_core.capture.dataset.files import Topology
from pica_core.errors import CaptureError
from pica_core.model.interface import FacePrior, LinearPrior
from pica_core.model.linear import CODE_SIZE
from pica_core.model.networks import resize_texture, sample_map
from pica_core.train.config import MeshSource
from pica_core.train.raster import GLRasteriser, Views
from pica_core.types import Array, BoolArray, Float64Array, FloatArray, Image, Int64Array, IntArray

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
    with GLRasteriser(both_sides, len(flat)) as rasteriser:
        found = rasteriser.triangles(torch.from_numpy(flat)[None], Views.of([camera]))
    ids = found.view(size, size).numpy()
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
    return (areas / areas.sum(1, keepdims=True)).astype(np.float32)


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
        self._dense_vertex = capture.dense_vertex
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
        return self.best(self._train_frames[int(away.argmin())], name)

    def true_at_tracked(self, frame: int) -> FloatArray:
        """The best mesh at the vertices of the tracked topology, ``[Vt, 3]``."""
        return self.dense_m[frame, self._dense_vertex]

    def best(self, frame: int, name: TopologyName) -> FloatArray:
        """The mesh of a topology that `source` has, ``[V, 3]``: a tracked one on the dense topology
        through its position map where it has fewer vertices."""
        mesh: FloatArray = self.tracked_m[frame]
        if self.source == "truth":
            return self.dense_m[frame] if name == "dense" else self.true_at_tracked(frame)
        if name == "tracked" or self._tracked_raster is self.uv_raster:
            return mesh
        values = torch.from_numpy(self._tracked_raster.position_map(mesh))
        uv = torch.from_numpy(np.ascontiguousarray(self._capture.topology.vertex_uv, np.float32))
        found = sample_map(values.permute(2, 0, 1)[None], uv)[0]
        return found.contiguous().numpy()

    def position_map(self, frame: int) -> Tensor:
        """What encoders see of a frame's shape: offsets from the mean, in position scales, as a map
        ``[3, S, S]``; of the mesh that `source` names."""
        return self._map(frame, self.source)

    def _map_of(self, frame: int, source: MeshSource) -> Tensor:
        if source == "tracked":
            offset, raster = self.tracked_m[frame] - self.tracked_mean_m, self._tracked_raster
        else:
            offset, raster = self.dense_m[frame] - self.dense_mean_m, self.uv_raster
        found = raster.position_map(offset / self.position_scale_m)
        return torch.from_numpy(found).permute(2, 0, 1).contiguous()


def important_vertices(topology: Topology) -> BoolArray:
    """Which vertices are of `IMPORTANT_REGIONS`. bool ``[V]``."""
    return np.logical_or.reduce([topology.region(n) for n in IMPORTANT_REGIONS])


def vertex_importance(
    topology: Topology, region_weight: float = 4.0, lid_weight: float = 16.0
) -> FloatArray:
    """How much an error of each vertex counts: mouth and eyes above the rest, lids most. ``[V]``"""
    weights = {**dict.fromkeys(IMPORTANT_REGIONS, region_weight), "lids": lid_weight}
    return topology.by_region(weights, 1.0).astype(np.float32)


MAX_RARITY = 8.0
"""Limit of a frame's weight against the usual one (chosen: a full blink reaches 7)."""


def rarity(offsets_m: FloatArray, regions: dict[str, BoolArray]) -> Float64Array:
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


IMAGE_CACHE_BYTES = 4 << 30
"""Decoded images and depth kept in memory; the least recently used go first."""
DECODERS = min(16, os.cpu_count() or 2)
"""Threads that decode them, also before they are needed."""
MAX_TEXTURES = 2048
"""The same of textures as tensors: 0.8 MB each at 256 x 256."""


class ImageCache:
    """The images of a capture behind a cache of bounded size, and the cameras that took them.

    What it returns is shared: do not write into it. An image that cannot be read is a CaptureError.

    Attributes:
        evaluation_views: Cameras that errors are measured from; all where the capture names none.
    """

    def __init__(self, capture: Capture) -> None:
        self._capture = capture
        pixels = max(camera.width * camera.height for camera in capture.cameras)
        count = IMAGE_CACHE_BYTES // (4 * pixels)
        pool = ThreadPoolExecutor(DECODERS, thread_name_prefix="decode")
        self._read: Callable[..., Future[Array]] = lru_cache(max(count, 1))(pool.submit)
        self.camera_names = [camera.name for camera in capture.cameras]
        named = capture.info.get("evaluation_views", [])
        views = [name for name in self.camera_names if name in named]
        self.evaluation_views = views or self.camera_names
        self._texture = lru_cache(MAX_TEXTURES)(self._texture_of)
        self._head_pose = cache(lambda frame: capture.head_to_world(capture.frames[frame]))

    def image(self, frame: int, camera: str) -> Image:
        """An image; uint8 ``[H, W, 3]``."""
        return self._image(frame, camera).result()

    def depth_m(self, frame: int, camera: str) -> FloatArray:
        """Measured depth, 0 where unknown, float32 ``[H, W]``."""
        if not self._has_depth(frame, camera):
            unknown = self._capture.camera(camera)
            return np.zeros((unknown.height, unknown.width), np.float32)
        return self._depth(frame, camera).result()

    def mask(self, frame: int, camera: str) -> BoolArray:
        """Which pixels show the person, where the capture has masks. bool ``[H, W]``."""
        return self._mask(frame, camera).result()

    def texture(self, frame: int, size: int) -> Tensor:
        """The average texture of a frame, about [-1, 1], ``[3, size, size]``."""
        return self._texture(frame, size)

    def cameras_of(self, frame: int) -> tuple[str, ...]:
        """Cameras that have an image of a frame."""
        return self._capture.cameras_of(self._capture.frames[frame])

    def expect(self, images: list[tuple[int, str]], *, depth: bool) -> None:
        """Have images decoded while something else goes on."""
        for image in images:
            self._image(*image)
            if self._capture.has_masks:
                self._mask(*image)
        for image in images:
            if depth and self._has_depth(*image):
                self._depth(*image)

    def _image(self, frame: int, camera: str) -> Future[Image]:
        return self._read(self._capture.image, self._capture.frames[frame], camera)

    def _depth(self, frame: int, camera: str) -> Future[FloatArray]:
        return self._read(self._capture.depth_m, self._capture.frames[frame], camera)

    def _mask(self, frame: int, camera: str) -> Future[BoolArray]:
        return self._read(self._capture.mask, self._capture.frames[frame], camera)

    def camera(self, frame: int, name: str) -> Camera:
        """The camera of an image in the frame's head axes: head to camera."""
        return self._capture.camera(name).in_head(self._head_pose(frame))

    def _has_depth(self, frame: int, camera: str) -> bool:
        where = self._capture.frames[frame]
        path = multiface.part_path("depth", where.segment, where.name, camera)
        return self._capture.has_depth and (self._capture.path / path).is_file()

    def _texture_of(self, frame: int, size: int) -> Tensor:
        stored = torch.from_numpy(self._capture.average_texture(self._capture.frames[frame]))
        texture = stored.permute(2, 0, 1)[None].to(torch.float32) / 127.5 - 1
        return resize_texture(texture, size)[0]


def view_direction(camera: Camera) -> FloatArray:
    """Unit vector from the head's origin to a camera in head axes, ``[3]``."""
    centre = camera.centre_m
    return (centre / np.linalg.norm(centre)).astype(np.float32)


def spaced(frames: list[int], count: int) -> list[int]:
    """At most `count` of some frames, evenly spaced."""
    return frames[:: -(-len(frames) // count)] if count else []


class TrainingData:
    """The frames of a capture, ready for batches.

    Attributes:
        train_frames: Places in `Capture.frames` of those to train on.
        test_frames: The same of held-out ones.
        rarity: How rare each training frame is (`sampler.rarity`), ``[T]``.
        arkit: Expressions of all frames, ``[T, 52]``; 0 where the capture has none.

    Raises:
        CaptureError: No training or no test frames.
    """

    def __init__(self, capture: Capture) -> None:
        self.capture = capture
        self.train_frames = [i for i, f in enumerate(capture.frames) if f.split == "train"]
        self.test_frames = [i for i, f in enumerate(capture.frames) if f.split == "test"]
        if not self.train_frames or not self.test_frames:
            raise CaptureError(
                f"{capture.path}: {len(self.train_frames)} training and {len(self.test_frames)} "
                "test frames; at least one of each is needed"
            )
        self.meshes = CaptureMeshes(capture, self.train_frames)
        self.images = ImageCache(capture)
        offsets_m = self.meshes.dense_m[self.train_frames] - self.meshes.dense_mean_m
        self.rarity = rarity(offsets_m, capture.topology.regions)
        self.arkit = torch.zeros(len(capture.frames), NUM_ARKIT)
        if capture.has_expressions:
            self.arkit = torch.tensor(np.array([frame.arkit for frame in capture.frames]))

    def draw(self, count: int, balance: float, rng: np.random.Generator) -> list[int]:
        """Draw training frames, with repetition, rare ones more often by the power `balance`."""
        weights = self.rarity**balance
        return rng.choice(self.train_frames, count, p=weights / weights.sum()).tolist()


PRIOR_FRAMES = 1024
"""Frames that bases are made of, at most: 2 MB each on the way (a face has some 60 bases)."""
READ_TEXELS = 8192
"""Texels of a position map that the encoder of bases reads: every sixth or so."""
RIDGE = 1e-7
"""Strength of that regression, against the mean square of a map."""
TEXTURE_FRAMES = 32
"""Training frames whose average textures make the mean one: evenly spaced, enough for a start."""


def face_prior(data: TrainingData, variant: str = "full") -> FacePrior:
    """The prior of a capture for a model of `VARIANTS`, from its training frames alone.

    Raises:
        CaptureError: The variant needs bases, and the capture has too few meshes for them.
    """
    capture = data.capture
    some = [capture.frames[index] for index in spaced(data.train_frames, TEXTURE_FRAMES)]
    texture = np.zeros((capture.texture_size, capture.texture_size, 3))
    for frame in some:
        texture += capture.average_texture(frame)
    return FacePrior(
        position_mean=data.meshes.position_mean,
        tracked_position_mean=data.meshes.tracked_position_mean(),
        position_scale_m=data.meshes.position_scale_m,
        dense_uv=_float32(capture.topology.vertex_uv),
        tracked_uv=_float32(capture.tracked_topology.vertex_uv),
        tracked_mean_m=_float32(data.meshes.tracked_mean_m),
        texture_mean=_float32(texture / (255 * len(some))),
        linear=linear_prior(data) if VARIANTS[variant].geometry == "bases" else None,
    )


def linear_prior(data: TrainingData) -> LinearPrior:
    """Bases of a capture's training meshes, and how an encoder reads their weights off a map.

    Raises:
        CaptureError: Too few meshes.
    """
    meshes, frames = data.meshes, spaced(data.train_frames, PRIOR_FRAMES)
    dense_m = np.stack([meshes.best(frame, "dense") for frame in frames])
    tracked_m = np.stack([meshes.best(frame, "tracked") for frame in frames])
    num_dense = dense_m.shape[1]
    # One set of weights for both meshes; the dense one alone says which.
    counts = np.zeros(num_dense + tracked_m.shape[1], np.float32)
    counts[:num_dense] = vertex_importance(data.capture.topology)
    both = fit_bases(np.concatenate([dense_m, tracked_m], 1), CODE_SIZE, counts)
    weights = both.weights_of(np.concatenate([dense_m, tracked_m], 1))
    uv = data.capture.topology.vertex_uv
    dense = both.select(np.arange(num_dense, dtype=np.int32))
    maps = np.stack([meshes.position_map(frame).flatten(1).numpy() for frame in frames])
    covered = np.flatnonzero(maps.any((0, 1)))
    texels = np.sort(np.random.default_rng(0).permutation(covered)[:READ_TEXELS])
    read = maps[:, :, texels].reshape(len(frames), -1).astype(np.float64)
    products = read @ read.T
    products += RIDGE * np.trace(products) / len(products) * np.eye(len(products))
    return LinearPrior(
        tracked=both.select(np.arange(num_dense, len(counts), dtype=np.int32)),
        parts=split_bases(dense, uv),
        texels=texels.astype(np.int32),
        projection=_float32(np.linalg.solve(products, weights).T @ read),
        deviation_m=_float32(np.sqrt(np.square(dense.components_m).sum(2).mean(1))),
    )


def _float32(array: npt.ArrayLike) -> FloatArray:
    return np.ascontiguousarray(array, np.float32)
