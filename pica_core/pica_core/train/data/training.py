"""A capture as tensors: its meshes, its images behind a cache, which frames are drawn (rare
expressions more often), and what it tells a model before training.
"""

from functools import cache, lru_cache

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.linear import fit_bases, split_bases
from pica_core.avatar.variants import VARIANTS
from pica_core.camera import Camera
from pica_core.capture.dataset import multiface
from pica_core.capture.dataset.dataset import Capture, CaptureReader, Request
from pica_core.errors import CaptureError
from pica_core.model.encoder import resize_texture
from pica_core.model.interface import FacePrior, LinearPrior
from pica_core.model.linear import CODE_SIZE
from pica_core.train.data.meshes import IMPORTANT_REGIONS, CaptureMeshes, vertex_importance
from pica_core.types import BoolArray, Float64Array, FloatArray, Image

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
"""Decoded images, depth and textures kept in memory; the least recently used go first."""
MAX_TEXTURES = 2048
"""The same of textures as tensors: 0.8 MB each at 256 x 256."""


class ImageCache:
    """The images of a capture behind a cache of bounded size, and the cameras that took them.

    Attributes:
        evaluation_views: Cameras that errors are measured from; all where the capture names none.
    """

    def __init__(self, capture: Capture) -> None:
        self._capture = capture
        self.reader = CaptureReader(capture, IMAGE_CACHE_BYTES)
        self.camera_names = [camera.name for camera in capture.cameras]
        named = capture.info.get("evaluation_views", [])
        views = [name for name in self.camera_names if name in named]
        self.evaluation_views = views or self.camera_names
        self._texture = lru_cache(MAX_TEXTURES)(self._texture_of)
        self._cameras_of = cache(lambda frame: capture.cameras_of(capture.frames[frame]))
        self._head_pose = cache(lambda frame: capture.head_to_world(capture.frames[frame]))

    def image(self, frame: int, camera: str) -> Image:
        """An image; uint8 ``[H, W, 3]``.

        Raises:
            CaptureError: It cannot be read.
        """
        return self.reader.read(Request("image", frame, camera))

    def depth_m(self, frame: int, camera: str) -> FloatArray:
        """Measured depth, 0 where unknown, float32 ``[H, W]``."""
        if not self._has_depth(frame, camera):
            unknown = self._capture.camera(camera)
            return np.zeros((unknown.height, unknown.width), np.float32)
        depth_m: FloatArray = self.reader.read(Request("depth", frame, camera))
        return depth_m

    def textures(self, frames: list[int], size: int) -> Tensor:
        """Average textures of frames, about [-1, 1], ``[N, 3, size, size]``."""
        return torch.stack([self._texture(frame, size) for frame in frames])

    def cameras_of(self, frame: int) -> tuple[str, ...]:
        """Cameras that have an image of a frame."""
        return self._cameras_of(frame)

    def evaluation_views_of(self, frame: int) -> list[str]:
        """Evaluation views that have an image of a frame."""
        return [name for name in self.evaluation_views if name in self.cameras_of(frame)]

    def expect(self, images: list[tuple[int, str]], *, depth: bool) -> None:
        """Have images decoded while something else goes on."""
        self.reader.ask(Request("image", *image) for image in images)
        if depth:
            self.reader.ask(Request("depth", *image) for image in images if self._has_depth(*image))

    def camera(self, frame: int, name: str) -> Camera:
        """The camera of an image in the frame's head axes: head to camera."""
        return self._capture.camera(name).in_head(self._head_pose(frame))

    def _has_depth(self, frame: int, camera: str) -> bool:
        where = self._capture.frames[frame]
        path = multiface.image_path("depth", where.segment, camera, where.name)
        return self._capture.has_depth and (self._capture.path / path).is_file()

    def _texture_of(self, frame: int, size: int) -> Tensor:
        stored = torch.from_numpy(self.reader.read(Request("texture", frame)).copy())
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
            self.arkit = torch.from_numpy(np.stack([capture.arkit(f) for f in capture.frames]))

    def draw(self, count: int, balance: float, rng: np.random.Generator) -> list[int]:
        """Draw training frames, with repetition, rare ones more often by the power `balance`."""
        weights = self.rarity**balance
        drawn: list[int] = rng.choice(self.train_frames, count, p=weights / weights.sum()).tolist()
        return drawn


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
    meshes, frames = data.meshes, data.train_frames
    dense_m = np.stack([meshes.best_dense(frame) for frame in frames])
    tracked_m = np.stack([meshes.best_tracked(frame) for frame in frames])
    num_dense = dense_m.shape[1]
    # One set of weights for both meshes; the dense one alone says which.
    counts = np.zeros(num_dense + tracked_m.shape[1], np.float32)
    counts[:num_dense] = vertex_importance(data.capture.topology)
    both = fit_bases(np.concatenate([dense_m, tracked_m], 1), CODE_SIZE, counts)
    weights = both.weights_of(np.concatenate([dense_m, tracked_m], 1))
    uv = data.capture.topology.vertex_uv
    dense = both.select(np.arange(num_dense, dtype=np.int32))
    maps = np.stack([meshes.position_maps([frame])[0].flatten(1).numpy() for frame in frames])
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
