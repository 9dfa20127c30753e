"""Train the models of the paper's tables on captures, with one preset and one seed.

    python scripts/train_tables.py --captures captures/S1 captures/S4 --out runs
    pica eval --table 1 --runs runs/* --out table1

Each run goes into ``OUT/CAPTURE-VARIANT`` (``-BLOCK`` after it for `--blocks`), as `pica train`
would leave it, but for the driver phase, which no table looks at (`pica train --resume` would add
it). The geometry phase knows nothing of encodings: models that decode the same mesh have the same
weights until it ends, bit for bit, so it is trained once for all of them. What is finished is left
alone, so several processes can share the work: each takes what nobody has taken, and a run that
was stopped goes on.
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from claims import give_back, take

from pica_core.avatar.variants import TABLE_1, TABLE_2, VARIANTS
from pica_core.capture.dataset.dataset import Capture
from pica_core.train.checkpoint import read_checkpoint
from pica_core.train.config import PRESETS, TrainConfig
from pica_core.train.data.training import TrainingData
from pica_core.train.eval.run import RUN_FILE
from pica_core.train.loop import Trainer, open_trainer

WATCH_EVERY = 100
"""Steps between looks at held-out frames: the curves of error against seconds."""


def main() -> None:
    """Train what is not trained yet."""
    options = read_options()
    torch.set_num_threads(options.threads)
    models = [(variant, "") for variant in options.variants]
    models += [("full", block) for block in options.blocks]
    for path in options.captures:
        data: TrainingData | None = None
        for variant, block in models:
            out = options.out / "-".join(filter(None, (path.name, variant, block)))
            config = configuration(options.preset, variant, block, options.seed)
            if is_done(out, config) or not take(out):
                continue
            data = data or TrainingData(Capture.open(path), config.model.spec().map_size)
            note = {"capture": str(path.resolve()), "identity": data.capture.info.get("head")}
            (out / RUN_FILE).write_text(json.dumps(note) + "\n")
            train(data, config, out, shared_geometry(options.out, path.name, variant, block))
            give_back(out)


def read_options() -> Any:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--captures", type=Path, nargs="+", required=True)
    parser.add_argument("--out", type=Path, required=True)
    variants = list(dict.fromkeys(TABLE_1 + TABLE_2))
    parser.add_argument("--variants", nargs="*", default=variants, choices=list(VARIANTS))
    parser.add_argument("--blocks", nargs="*", default=[], help="full with these blocks, too")
    parser.add_argument("--preset", default="small", choices=list(PRESETS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    return parser.parse_args()


def configuration(preset: str, variant: str, block: str, seed: int) -> TrainConfig:
    """The preset for one model."""
    config = PRESETS[preset]
    model = replace(config.model, variant=variant, block=block or config.model.block)
    return replace(config, model=model, seed=seed, watch_every=WATCH_EVERY)


def wanted_steps(config: TrainConfig) -> int:
    """Steps of the first two phases."""
    return config.schedule.geometry_steps + config.schedule.joint_steps


def is_done(out: Path, config: TrainConfig) -> bool:
    """Whether a run has its steps."""
    path = out / "checkpoint.pt"
    return path.exists() and read_checkpoint(path)["step"] >= wanted_steps(config)


def shared_geometry(out: Path, capture: str, variant: str, block: str) -> Path | None:
    """Where the geometry phase of models like this one is kept; None where there is one only."""
    row = VARIANTS[variant]
    if row.network != "pixel_codec" or row.topology != "dense":
        return None
    return out / "-".join(filter(None, (capture, "geometry", block))) / "checkpoint.pt"


def train(data: TrainingData, config: TrainConfig, out: Path, shared: Path | None) -> None:
    """Train one model through geometry and joint phase."""
    last = wanted_steps(config)
    with open_trainer(data, config, out) as trainer:
        if (out / "checkpoint.pt").exists():
            trainer.restore()
        elif shared is not None and shared.exists():
            take_geometry(trainer, shared)
        if shared is not None and not shared.exists():
            trainer.run(lambda step, *_: step < config.schedule.geometry_steps)
            shared.parent.mkdir(parents=True, exist_ok=True)
            os.link(out / "checkpoint.pt", shared)
        trainer.run(lambda step, *_: step < last)


def take_geometry(trainer: Trainer, shared: Path) -> None:
    """Begin where another model's geometry phase ended."""
    state = read_checkpoint(shared)
    own = trainer.model.state_dict()
    parts = ("encoder.", "geometry.")
    own |= {name: values for name, values in state["model"].items() if name.startswith(parts)}
    trainer.model.load_state_dict(own)
    trainer.step, trainer.seconds = state["step"], state["seconds"]


if __name__ == "__main__":
    main()
