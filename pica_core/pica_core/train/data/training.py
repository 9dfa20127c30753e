"""A capture as tensors: its meshes, its images behind a cache, and which frames are drawn: rare
expressions more often.
"""

import numpy as np
import torch

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.capture.dataset.dataset import Capture
from pica_core.errors import CaptureError
from pica_core.train.data.images import ImageCache
from pica_core.train.data.meshes import IMPORTANT_REGIONS, CaptureMeshes
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
