"""A capture as tensors: its meshes, its images behind a cache, and which frames are drawn."""

import numpy as np
import torch

from pica_core.avatar.arkit import NUM_ARKIT
from pica_core.capture.dataset.dataset import Capture
from pica_core.errors import CaptureError
from pica_core.train.data.images import ImageCache
from pica_core.train.data.meshes import CaptureMeshes
from pica_core.train.data.sampler import rarity


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
