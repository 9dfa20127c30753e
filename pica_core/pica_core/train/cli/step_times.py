"""`pica bench train`."""

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import torch

from pica_core.capture.dataset.dataset import Capture
from pica_core.errors import TrainingOptionError, check_ranges
from pica_core.train.config import PAPER_LOSSES, PRESETS
from pica_core.train.data.training import TrainingData
from pica_core.train.loop import open_trainer
from pica_core.train.trials.step_times import time_steps
from pica_core.train.trials.stopwatch import PARTS


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchTrainOptions:
    """Options of `pica bench train`."""

    capture: Path
    """Folder of the capture."""
    preset: Literal["tiny", "small", "long", "paper"] = "small"
    """Whose joint phase to measure."""
    six_losses: bool = False
    """Measure with all six losses of the paper, whatever the preset has."""
    edges: bool = False
    """Measure with the gradient of silhouettes, too."""
    steps: int = 20
    """Steps to measure, after five to warm up."""
    threads: int = 2
    """CPU threads of torch."""

    def __post_init__(self) -> None:
        check_ranges(self, TrainingOptionError, steps=(1, 100_000), threads=(1, 1024))


def bench_train(options: BenchTrainOptions) -> dict[str, Any]:
    """Say where the time of a training step goes. Weights are thrown away."""
    torch.set_num_threads(options.threads)
    config = PRESETS[options.preset]
    losses = PAPER_LOSSES if options.six_losses else config.losses
    losses = replace(losses, edge=1.0 if options.edges else losses.edge)
    schedule = replace(config.schedule, geometry_steps=0, joint_steps=options.steps + 10)
    config = replace(config, losses=losses, schedule=schedule)
    data = TrainingData(Capture.open(options.capture), config.model.spec().map_size)
    with (
        tempfile.TemporaryDirectory() as folder,
        open_trainer(data, config, Path(folder)) as trainer,
    ):
        row = time_steps(trainer, options.steps)
    for name in ("step", *PARTS):
        low, middle, high = (row[f"{name}{which}_ms"] for which in ("_low", "", "_high"))
        print(f"{name:10}{middle:8.1f} ms  ({low:.1f} to {high:.1f})", file=sys.stderr)
    return {"preset": options.preset, "threads": options.threads, "steps": options.steps, **row}
