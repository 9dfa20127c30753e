"""Seconds per step of the joint phase, part by part: `pica bench train` and the log of results."""

import time
from typing import Any

import numpy as np
import torch

from pica_core.train.loop import Trainer
from pica_core.train.trials.stopwatch import PARTS


def time_steps(trainer: Trainer, steps: int, *, warm_up: int = 5) -> dict[str, Any]:
    """Do some steps and say where their time went.

    Args:
        trainer: Whose current phase is measured; its steps count as trained.
        steps: Measured ones.
        warm_up: Steps before, in which buffers grow; textures and meshes are read before them.

    Returns:
        ``{part}_ms`` for each of `PARTS` and ``step_ms``: medians; ``{...}_low_ms`` and
        ``{...}_high_ms``: quartiles. "step" holds what no part does, too.
    """
    stopwatch = trainer.objectives.stopwatch
    with torch.no_grad():  # a run reads each texture and mesh once
        for frame in trainer.data.train_frames:
            trainer.objectives.encode([frame])
    stopwatch.synchronise = trainer.device.type == "cuda"
    found: dict[str, list[float]] = {name: [] for name in (*PARTS, "step")}
    for index in range(warm_up + steps):
        stopwatch.clear()
        started = time.perf_counter()
        trainer.train_step()
        whole = time.perf_counter() - started
        if index >= warm_up:
            for name, seconds in (stopwatch.seconds | {"step": whole}).items():
                found[name].append(1000 * seconds)
    row: dict[str, Any] = {}
    for name, values in found.items():
        low, middle, high = np.percentile(values, (25, 50, 75))
        row |= {f"{name}_ms": middle, f"{name}_low_ms": low, f"{name}_high_ms": high}
    return row
