"""Several processes that train one model: each takes its part of every batch.

Every process draws the same batch from (seed, step) and computes the losses of its own part; the
gradients are averaged before each optimiser step. All losses are means over images or meshes and
all parts are of one size, so the average is the gradient of the whole batch, up to the order of
additions, and all processes hold the same weights at all times.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

import torch
import torch.distributed.nn
from torch import Tensor, distributed, nn

from pica_core.errors import TrainingOptionError

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Ranks:
    """This process among its fellows."""

    rank: int = 0
    """Number of this process, from 0."""
    count: int = 1
    """Number of processes."""

    @property
    def is_first(self) -> bool:
        """Whether this process writes the files."""
        return self.rank == 0

    def mine(self, items: list[Item]) -> list[Item]:
        """This process's part of a whole batch, which is `count` parts long."""
        part = len(items) // self.count
        return items[self.rank * part : (self.rank + 1) * part]

    def average(self, values: Tensor) -> Tensor:
        """The mean of a tensor over all processes; in place, and returned."""
        if self.count > 1:
            distributed.all_reduce(values)
            values /= self.count
        return values

    def average_gradients(self, parameters: Iterable[nn.Parameter]) -> None:
        """Replace gradients by their mean over all processes."""
        if self.count == 1:
            return
        gradients = [p.grad for p in parameters if p.grad is not None]
        flat = self.average(torch.cat([gradient.reshape(-1) for gradient in gradients]))
        start = 0
        for gradient in gradients:
            gradient.copy_(flat[start : start + gradient.numel()].view_as(gradient))
            start += gradient.numel()

    def wait(self) -> None:
        """Go on when all processes have come here."""
        if self.count > 1:
            distributed.barrier()


@contextmanager
def open_ranks(environment: Mapping[str, str]) -> Iterator[Ranks]:
    """The process's place among those that ``torchrun`` started; alone without it.

    The functions of torch.distributed.nn keep, as their default, whatever group exists when the
    module is first imported. It is imported above, while there is none: a group that is kept
    outlives its destruction, and its threads can abort the process when the interpreter ends.

    Args:
        environment: Variables that torchrun sets: RANK, WORLD_SIZE, MASTER_ADDR, MASTER_PORT.

    Raises:
        TrainingOptionError: Some of them are set and others are not, or not numbers.
    """
    if "WORLD_SIZE" not in environment:
        yield Ranks()
        return
    try:
        ranks = Ranks(int(environment["RANK"]), int(environment["WORLD_SIZE"]))
    except (KeyError, ValueError) as error:
        raise TrainingOptionError(
            f"WORLD_SIZE is {environment['WORLD_SIZE']!r} but RANK is "
            f"{environment.get('RANK')!r}; start several processes with torchrun"
        ) from error
    # Losses and whether to go on are tensors of the CPU.
    backend = "cpu:gloo,cuda:nccl" if torch.cuda.is_available() else "gloo"
    distributed.init_process_group(backend, rank=ranks.rank, world_size=ranks.count)
    try:
        yield ranks
    finally:
        distributed.destroy_process_group()
