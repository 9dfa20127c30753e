"""Train `full`, `baseline` and `linear` in turns on a borrowed machine, and end in time.

    pica capture person --lenses one --frames 60 --size 384x384 --out paper/capture
    python scripts/paper_run.py paper/capture --out paper --seconds 240
    python scripts/paper_run.py paper/capture --out paper --seconds 3600   # the same runs go on

A GPU is used if there is one. The models take the same number of steps each, and held-out takes are
measured from the evaluation views after every turn. In the folder: the runs, `curves.json` (errors
by steps and seconds), `table.md`, and in `light` checkpoints in half precision and without moments,
which another machine goes on from.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from pica_core.capture.dataset.dataset import Capture
from pica_core.train.cli.eval import error_table
from pica_core.train.config import PRESETS, TrainConfig
from pica_core.train.data import TrainingData
from pica_core.train.evaluate import evaluate, mean_mse
from pica_core.train.train import CHECKPOINT, Trainer, open_trainer

VARIANTS = ("full", "baseline", "linear")
FIRST_TURN, MOST_TURN, TURN_SHARE = 20, 250, 0.6
"""Steps of the first turn, which shows what one costs, and at most; part of the time left for the
next turns."""
EVAL_FRAMES = 5
END_S = 15.0
"""Left for the last table."""
Curves = dict[str, list[dict[str, Any]]]


def main() -> None:
    """Train until the time is over, and show the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="runs and table")
    parser.add_argument("--seconds", type=float, default=240.0, help="ends before that")
    parser.add_argument("--preset", default="paper", choices=list(PRESETS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=8)
    options = parser.parse_args()
    until = time.monotonic() + options.seconds - END_S
    torch.set_num_threads(options.threads)
    data = TrainingData(Capture.open(options.capture))
    config = replace(PRESETS[options.preset], seed=options.seed)
    with ExitStack() as stack:
        trainers = [
            stack.enter_context(opened(options.out, replace(config, variant=variant), data))
            for variant in VARIANTS
        ]
        curves = take_turns(trainers, options.out, until)
    points = [point for curve in curves.values() for point in curve]
    reached = [{point["steps"] for point in curve} for curve in curves.values()]
    last = max(set.intersection(*reached), default=0)
    rows = [row for point in points if point["steps"] == last for row in point["rows"]]
    table = f"After {last} steps:\n\n{error_table(rows)}\n"
    (options.out / "table.md").write_text(table)
    print(table)


@contextmanager
def opened(out: Path, config: TrainConfig, data: TrainingData) -> Iterator[Trainer]:
    """A run, gone on with where it was stopped, here or on another machine."""
    own = out / config.variant
    device = "cuda" if torch.cuda.is_available() else "cpu"
    with open_trainer(data, config, own, device=device) as trainer:
        folders = [own, out / "light" / config.variant]
        if stopped := [each for each in folders if (each / CHECKPOINT).exists()]:
            trainer.restore(stopped[0])
        yield trainer


def take_turns(trainers: list[Trainer], out: Path, until: float) -> Curves:
    """Let the models take turns until the time is over; the curve of each."""
    path = out / "curves.json"
    curves: Curves = json.loads(path.read_text()) if path.exists() else {}
    steps = FIRST_TURN
    while steps >= FIRST_TURN and all(each.step < each.total_steps for each in trainers):
        began = time.monotonic()
        end = min(trainer.step for trainer in trainers) + steps
        for trainer in trainers:
            curves.setdefault(trainer.config.variant, []).append(turn(trainer, end, out, until))
        path.write_text(json.dumps(curves, indent=1) + "\n")
        now = time.monotonic()
        # So that the next turns of all end in time.
        steps = min(MOST_TURN, int(steps * TURN_SHARE * (until - now) / (now - began)))
    return curves


def turn(trainer: Trainer, end: int, out: Path, until: float) -> dict[str, Any]:
    """Some steps of a run, and a point of its curve."""
    variant = trainer.config.variant
    trainer.run(lambda step, _phase, _losses: step < end and time.monotonic() < until)
    rows = evaluate(trainer, max_frames=EVAL_FRAMES, sources=("encoder",))
    light = out / "light" / variant
    light.mkdir(parents=True, exist_ok=True)
    trainer.save(light, light=True)
    error = mean_mse(rows)
    told(f"{variant}: {trainer.step} steps, {trainer.seconds:.0f} s, MSE {error:.2f}")
    return {"steps": trainer.step, "seconds": trainer.seconds, "mse": error, "rows": rows}


def told(text: str) -> None:
    """Say something at once."""
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
