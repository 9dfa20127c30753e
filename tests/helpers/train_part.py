"""One of the processes that train together, for tests: started with the variables of torchrun."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import torch

from pica_core.capture.dataset.dataset import Capture
from pica_core.train.config import TrainConfig
from pica_core.train.data.training import TrainingData
from pica_core.train.loop import open_trainer
from pica_core.train.parallel import open_ranks


def main(capture: str, out: str, config: str) -> None:
    torch.set_num_threads(1)
    options = TrainConfig.from_json(json.loads(config))
    data = TrainingData(Capture.open(capture))
    with (
        open_ranks(os.environ) as ranks,
        open_trainer(data, options, Path(out), ranks=ranks) as trainer,
    ):
        trainer.run()
    if any("gloo_runloop" in task.read_text() for task in Path("/proc/self/task").glob("*/comm")):
        raise AssertionError("the process group's threads outlive the process group")


if __name__ == "__main__":
    main(*sys.argv[1:])
