"""Steps on a GPU: the first launch every kernel, the others repeat a CUDA graph of them all.

A small step is a thousand kernels of microseconds each; launched from Python one by one they take
ten times as long as they work. A graph has fixed inputs, shapes and memory: batches are copied into
its own tensors, and lists whose length changes are given room (`raster.Capacity`).
"""

import logging
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from pica_core.train.objectives import Batch
from pica_core.train.raster import Capacity

WARM_UP = 3
"""Steps before the graph is made: libraries choose their kernels, lists show their lengths."""
logger = logging.getLogger(__name__)


class ReplayedStep:
    """One kind of step.

    Args:
        work: Does a step on a batch of the device and returns its losses.
        capacities: Of the lists in it whose length changes.
    """

    def __init__(
        self, work: Callable[[Batch], Tensor], capacities: Sequence[Capacity], device: torch.device
    ) -> None:
        self._work, self._capacities, self._device = work, capacities, device
        self._left = WARM_UP
        self._stream = torch.cuda.Stream(device)  # type: ignore[no-untyped-call]
        self._graph: torch.cuda.CUDAGraph | None = None
        self._batch: Batch = {}
        self._values = torch.zeros(0)
        self._needed: list[tuple[Capacity, Tensor]] = []
        self._can_replay = True

    def __call__(self, batch: Batch) -> Tensor:
        """Do a step and return its losses, without waiting for the GPU where a graph repeats it."""
        # A list of the last step that had more entries than room is asked for more.
        if self._graph and any([each.was_short(int(needed)) for each, needed in self._needed]):
            self._graph = None
        if self._graph is None and self._left == 0 and self._can_replay:
            self._capture(batch)
        if self._graph is None:
            self._left = max(0, self._left - 1)
            return self._launch({name: given.to(self._device) for name, given in batch.items()})
        for name, given in batch.items():
            self._batch[name].copy_(given, non_blocking=True)
        self._graph.replay()
        return self._values

    def _launch(self, batch: Batch) -> Tensor:
        now = torch.cuda.current_stream(self._device)
        self._stream.wait_stream(now)
        with torch.cuda.stream(self._stream):
            values = self._work(batch)
        now.wait_stream(self._stream)
        return values

    def _capture(self, batch: Batch) -> None:
        """Make the graph; where that fails every step launches its kernels."""
        self._batch = {name: given.to(self._device, copy=True) for name, given in batch.items()}
        graph = torch.cuda.CUDAGraph()
        for capacity in self._capacities:
            capacity.fix()
        try:
            with torch.cuda.graph(graph, stream=self._stream, capture_error_mode="thread_local"):
                self._values = self._work(self._batch)
                self._needed = [(c, c.needed) for c in self._capacities if c.needed is not None]
            self._graph = graph
        except RuntimeError as error:
            self._can_replay = False
            logger.warning("steps are not repeated from a CUDA graph: %s", error)
        finally:
            for capacity in self._capacities:
                capacity.release()
