"""Where the time of a training step goes."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import torch

PARTS = ("data", "encode", "decode", "raster", "pixel", "loss", "backward", "optimiser")
"""Parts of a step, in order. "raster" holds ids, choice of pixels and interpolation, "pixel" the
appearance's lookup and the pixel decoder, "decode" both per-object decoders."""


class Stopwatch:
    """Seconds of each part of the steps since `clear`.

    With a GPU a part ends when its work is done only if `synchronise` is set; without, the times
    are those of handing the work over.
    """

    def __init__(self) -> None:
        self.synchronise = False
        self.seconds = dict.fromkeys(PARTS, 0.0)

    def clear(self) -> None:
        """Forget what was measured."""
        self.seconds = dict.fromkeys(PARTS, 0.0)

    @contextmanager
    def __call__(self, part: str) -> Iterator[None]:
        """Measure a block."""
        started = self._now()
        try:
            yield
        finally:
            self.seconds[part] += self._now() - started

    def _now(self) -> float:
        if self.synchronise:
            torch.cuda.synchronize()
        return time.perf_counter()
