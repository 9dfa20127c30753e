"""Train `full`, `baseline` and `linear` in turns on a borrowed machine, and end in time.

    pica capture person --folds --hair bob --lenses one --frames 360 --size 384x384 --out capture
    python scripts/paper_run.py capture --out paper --seconds 240
    python scripts/paper_run.py capture --out paper --seconds 3600   # the same runs go on

A GPU is used if there is one. The models take the same number of joint steps; before those `full`
and `baseline` learn geometry alone, if the preset says so. Held-out takes are measured from three
views after every turn. In the folder: the runs, `curves.json`, `table.md`, and in `light` half
checkpoints without moments for another machine. `chart.py --record paper` keeps the curves.
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
from pica_core.train.cli.eval import report
from pica_core.train.config import PRESETS, TrainConfig
from pica_core.train.data import TrainingData
from pica_core.train.evaluate import evaluate, mean_mse
from pica_core.train.train import CHECKPOINT, Trainer, open_trainer

VARIANTS = ("full", "baseline", "linear")
FIRST_TURN, MOST_TURN, TURN_SHARE = 20, 250, 0.6
"""Steps of the first turn, which shows what one costs, and at most; part of the time left for the
next turns."""
EVAL_FRAMES, VIEWS = 5, 3
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
    parser.add_argument("--steps", type=int, help="joint steps of a whole run")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=8)
    options = parser.parse_args()
    until = time.monotonic() + options.seconds - END_S
    torch.set_num_threads(options.threads)
    data = TrainingData(Capture.open(options.capture))
    data.images.evaluation_views = data.images.evaluation_views[:VIEWS]
    preset = PRESETS[options.preset]
    steps = options.steps or preset.joint_steps
    geometry = round(preset.geometry_steps * steps / preset.joint_steps)
    phases: dict[str, Any] = {"geometry_steps": geometry, "joint_steps": steps, "driver_steps": 0}
    config = replace(preset, seed=options.seed, **phases)
    with ExitStack() as stack:
        trainers = [
            stack.enter_context(opened(options.out, replace(config, variant=variant), data))
            for variant in VARIANTS
        ]
        curves = take_turns(trainers, options.out, until)
    rows = [row for curve in curves.values() for row in curve[-1]["rows"]]
    told = report({"captures": [str(options.capture)], "rows": rows})
    (options.out / "table.md").write_text(told)
    shown = {name: [p["shown"] for p in curve] for name, curve in curves.items()}
    print(json.dumps({"curves": shown}))


@contextmanager
def opened(out: Path, config: TrainConfig, data: TrainingData) -> Iterator[Trainer]:
    """A run, gone on with where it was stopped, here or on another machine."""
    own = out / config.variant
    device = "cuda" if torch.cuda.is_available() else "cpu"
    if config.variant == "linear":  # its geometry is computed
        config = replace(config, geometry_steps=0)
    with open_trainer(data, config, own, device=device) as trainer:
        folders = [own, out / "light" / config.variant]
        if stopped := [each for each in folders if (each / CHECKPOINT).exists()]:
            trainer.restore(stopped[0])
        yield trainer


def joint_steps(trainer: Trainer) -> int:
    """How many a run has done."""
    return max(0, trainer.step - trainer.config.geometry_steps)


def take_turns(trainers: list[Trainer], out: Path, until: float) -> Curves:
    """Let the models take turns until the time is over; the curve of each."""
    path = out / "curves.json"
    curves: Curves = json.loads(path.read_text()) if path.exists() else {}
    for each in trainers:  # geometry first: a turn is to say what joint steps cost
        if not joint_steps(each):
            each.run(lambda *_, run=each: not joint_steps(run) and time.monotonic() < until)
    steps = FIRST_TURN
    while steps >= FIRST_TURN and all(each.step < each.total_steps for each in trainers):
        began = time.monotonic()
        end = min(map(joint_steps, trainers)) + steps
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
    if joint_steps(trainer) < end:
        trainer.run(lambda *_: joint_steps(trainer) < end and time.monotonic() < until)
    rows = evaluate(trainer, max_frames=EVAL_FRAMES, sources=("encoder",))
    light = out / "light" / variant
    light.mkdir(parents=True, exist_ok=True)
    trainer.save(light, light=True)
    shown = {
        "joint steps": joint_steps(trainer),
        "seconds": round(trainer.seconds, 1),
        "MSE": mean_mse(rows),
        "vertices off, mm": rows[0]["vertex_error_mm"],
    }
    print(variant, shown, file=sys.stderr, flush=True)
    return {"shown": shown, "rows": rows}


if __name__ == "__main__":
    main()
