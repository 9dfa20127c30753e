"""Train the models of the paper's tables on captures, with several seeds, for `pica eval`.

    python scripts/train_tables.py --captures captures/S1 captures/S4 --out runs --seeds 3

A run goes to OUT/CAPTURE-VARIANT-SEED; one that is finished is left alone. Variants that differ in
nothing but what their pixel decoder is told about the surface have the geometry phase in common: it
draws no pictures, so for one seed it is trained once, and each of them goes on from there. None has
a driver phase, for the tables measure the model's own encoder.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import torch
import tyro

from pica_core.avatar.variants import TABLE_1, TABLE_2, VARIANTS
from pica_core.capture.dataset.dataset import Capture
from pica_core.train.checkpoint import NAME, read_checkpoint
from pica_core.train.config import PRESETS, TrainConfig
from pica_core.train.data.training import TrainingData
from pica_core.train.eval.run import RUN_FILE
from pica_core.train.loop import Trainer, open_trainer

MODELS = tuple(dict.fromkeys((*TABLE_1, *TABLE_2)))


@dataclass(frozen=True, kw_only=True, slots=True)
class TableOptions:
    """Which models to train on what."""

    captures: tuple[Path, ...]
    """Folders of captures."""
    out: Path
    """Folder of the runs."""
    variants: tuple[str, ...] = MODELS
    """Rows of docs/variants.md."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Of weights and batches."""
    preset: Literal["tiny", "small", "long"] = "small"
    """How much to train."""
    threads: int = 1
    """CPU threads of torch."""


def main() -> None:
    """Train what is not finished yet, seed by seed."""
    options = tyro.cli(TableOptions)
    torch.set_num_threads(options.threads)
    for seed in options.seeds:
        for path in options.captures:
            config = replace(PRESETS[options.preset], seed=seed)
            data = TrainingData(Capture.open(path))
            for variant in options.variants:
                train(data, config, variant, options)


def train(data: TrainingData, config: TrainConfig, variant: str, options: TableOptions) -> None:
    """Train one model to its end, or go on where it was stopped."""
    capture = data.capture.path
    folder = options.out / f"{capture.name}-{variant}-{config.seed}"
    own = config.changed(model={"variant": variant}, schedule={"driver_steps": 0})
    note: dict[str, str | int] = {"capture": str(capture.resolve()), "identity": capture.name}
    note |= {"variant": variant, "preset": options.preset, "seed": config.seed}
    with open_trainer(data, own, folder) as trainer:
        if (folder / NAME).exists():
            trainer.restore()
        elif shares_geometry(variant):
            go_on_from(trainer, geometry(data, config, options))
        (folder / RUN_FILE).write_text(json.dumps(note, indent=1) + "\n")
        if trainer.step < trainer.total_steps:
            trainer.run()
            told = f"{trainer.step} steps, {trainer.seconds:.0f} s"
            print(f"{folder.name}: {told}", file=sys.stderr, flush=True)


def shares_geometry(variant: str) -> bool:
    """Whether a model is `full` but for what its pixel decoder is told."""
    return replace(VARIANTS[variant], encoding="full") == VARIANTS["full"]


def geometry(data: TrainingData, config: TrainConfig, options: TableOptions) -> Path:
    """Folder of a run of `full` that ends with its geometry phase; trained where it is missing."""
    folder = options.out / f"{data.capture.path.name}-geometry-{config.seed}"
    schedule = {"joint_steps": 0, "driver_steps": 0}
    with open_trainer(
        data, config.changed(model={"variant": "full"}, schedule=schedule), folder
    ) as trainer:
        if (folder / NAME).exists():
            trainer.restore()
        if trainer.step < trainer.total_steps:
            trainer.run()
    return folder


def go_on_from(trainer: Trainer, folder: Path) -> None:
    """Take the weights that the geometry phase has trained, and what it has spent."""
    state = read_checkpoint(folder / NAME)
    weights = state["model"].items()
    learned = {name: part for name, part in weights if not name.startswith("pixel_decoder.")}
    trainer.model.load_state_dict(trainer.model.state_dict() | learned)
    trainer.objectives.mean_m.copy_(state["mean_mesh_m"])
    trainer.step, trainer.seconds = state["step"], state["seconds"]


if __name__ == "__main__":
    main()
