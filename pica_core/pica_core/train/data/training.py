"""A capture as tensors: its meshes, its images behind a cache, which frames are drawn (rare
expressions more often), and what it tells a model before training.
"""

import numpy as np
import numpy.typing as npt
import torch

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.avatar.linear import fit_bases, split_bases
from pica_core.avatar.variants import VARIANTS
from pica_core.capture.dataset.dataset import Capture
from pica_core.errors import CaptureError
from pica_core.model.interface import FacePrior, LinearPrior
from pica_core.model.linear import CODE_SIZE
from pica_core.train.data.images import ImageCache
from pica_core.train.data.meshes import IMPORTANT_REGIONS, CaptureMeshes, vertex_importance
from pica_core.types import BoolArray, Float64Array, FloatArray

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
        CaptureError: The variant needs bases, and the capture has too few good meshes for them.
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
        CaptureError: Too few good meshes.
    """
    meshes, frames = data.meshes, data.train_frames
    dense_m = np.stack([meshes.best_dense(frame) for frame in frames])
    tracked_m = np.stack([meshes.best_tracked(frame) for frame in frames])
    num_dense = dense_m.shape[1]
    # One set of weights for both meshes; the dense one alone says which.
    counts = np.zeros(num_dense + tracked_m.shape[1], np.float32)
    counts[:num_dense] = vertex_importance(data.capture.topology)
    both = fit_bases(np.concatenate([dense_m, tracked_m], 1), CODE_SIZE, counts)
    used = [i for i in range(len(frames)) if i not in both.left_out]
    weights = both.weights_of(np.concatenate([dense_m[used], tracked_m[used]], 1))
    uv = data.capture.topology.vertex_uv
    dense = both.select(np.arange(num_dense, dtype=np.int32))
    maps = np.stack([meshes.position_maps([frames[i]])[0].flatten(1).numpy() for i in used])
    covered = np.flatnonzero(maps.any((0, 1)))
    texels = np.sort(np.random.default_rng(0).permutation(covered)[:READ_TEXELS])
    read = maps[:, :, texels].reshape(len(used), -1).astype(np.float64)
    products = read @ read.T
    products += RIDGE * np.trace(products) / len(products) * np.eye(len(products))
    notes = []
    if both.left_out:
        named = ", ".join(data.capture.frames[frames[i]].name for i in both.left_out[:8])
        notes.append(
            f"{len(both.left_out)} meshes are unlike all others and made no bases: {named}"
        )
    return LinearPrior(
        tracked=both.select(np.arange(num_dense, len(counts), dtype=np.int32)),
        parts=split_bases(dense, uv),
        texels=texels.astype(np.int32),
        projection=_float32(np.linalg.solve(products, weights).T @ read),
        deviation_m=_float32(np.sqrt(np.square(dense.components_m).sum(2).mean(1))),
        notes=tuple(notes),
    )


def _float32(array: npt.ArrayLike) -> FloatArray:
    return np.ascontiguousarray(array, np.float32)
