"""Train as the paper did on a borrowed machine, in one command that ends in time.

    python scripts/paper_run.py --out paper --seconds 240      # on a GPU, where there is one
    python scripts/paper_run.py --out paper --seconds 3600     # goes on with the same runs
    python scripts/paper_run.py --out try --seconds 120 --preset tiny --size 96x96 --frames 12

A capture of a person is made where none is given. Joint steps a second are measured, of 2048 x 1334
pixels on a GPU alone; then `full`, `baseline` and `linear` take turns, the same number of steps
each, and held-out takes are measured from the evaluation views after every turn. In the folder:
`speed.json`, `curves.json`, `table.md`, the runs, and in `light` checkpoints in half precision and
without moments, which a next machine goes on from.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import torch

from pica_core.capture.dataset.dataset import Capture
from pica_core.cli import PersonOptions, person
from pica_core.errors import PicaCoreError
from pica_core.train.cli.eval import error_table
from pica_core.train.config import PRESETS
from pica_core.train.data import TrainingData
from pica_core.train.evaluate import evaluate, mean_mse
from pica_core.train.objectives import Draw
from pica_core.train.train import CHECKPOINT, Trainer, open_trainer

VARIANTS = ("full", "baseline", "linear")
CASES = (
    ("small", "full", "small"),
    ("paper", "full", "small"),
    ("paper", "full", "large"),
    ("small", "baseline", "small"),
    ("small", "linear", "small"),
)
"""What is timed: preset, model, capture."""
LARGE = "1334x2048", 10, 5
"""Size (columns x rows), frames and cameras of the capture of the paper's size."""
SPEED_SHARE = 0.35
"""Part of the time that steps a second may take."""
WARM_STEPS, HEATED, TIMED_S = 6, 150, 3.0
"""Steps before the timed ones, in which the graph of a GPU is made; steps whose images are read
before; seconds of timed ones."""
FIRST_TURN, MOST_TURN, TURN_SHARE = 20, 250, 0.6
"""Steps of the first turn, which shows what one costs, and at most; part of the time left for the
next turns."""
EVAL_FRAMES = 5
END_S = 15.0
"""Left for the last tables."""
Curves = dict[str, list[dict[str, Any]]]


def main() -> None:
    """Make what is missing, measure, train until the time is over, and show the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="captures, runs and tables")
    parser.add_argument("--seconds", type=float, default=240.0, help="ends before that")
    parser.add_argument("--capture", type=Path, help="a capture, if none is to be made")
    parser.add_argument("--preset", default="paper", choices=list(PRESETS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=60, help="of the capture that is made")
    parser.add_argument("--size", default="384x384", help="of its images")
    parser.add_argument("--threads", type=int, default=8)
    options = parser.parse_args()
    started = time.monotonic()
    options.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(options.threads)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    data = make_captures(options, with_large=device == "cuda")
    told(f"captures ready after {time.monotonic() - started:.0f} s")
    speed = options.out / "speed.json"
    if not speed.exists():
        write(speed, speeds(data, device, time.monotonic() + SPEED_SHARE * options.seconds))
    curves = train(options, data["small"], device, started + options.seconds - END_S)
    tables = [speed_table(json.loads(speed.read_text())), curve_table(curves), last_table(curves)]
    (options.out / "table.md").write_text("\n\n".join(tables) + "\n")
    print("\n\n".join(tables))
    told(f"done after {time.monotonic() - started:.0f} of {options.seconds:.0f} s")


def make_captures(options: argparse.Namespace, *, with_large: bool) -> dict[str, TrainingData]:
    """Captures of a person, those made that are not there, in processes of their own."""
    stages = {"large": LARGE} if with_large else {}
    folders = {name: options.out / "captures" / name for name in ("small", "large")}
    if options.capture is None:
        stages["small"] = options.size, options.frames, 8
    else:
        folders["small"] = options.capture
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        made = [
            pool.submit(make_capture, folders[name], options.seed, *stage)
            for name, stage in stages.items()
        ]
        for each in made:
            told(each.result())
    wanted = ["small", *stages]
    return {name: TrainingData(Capture.open(folders[name])) for name in dict.fromkeys(wanted)}


def make_capture(out: Path, seed: int, size: str, frames: int, cameras: int) -> str:
    """Make a capture where it is not there; what was done, in words."""
    if (out / "person.json").exists():
        return f"{out}: there already"
    result = person(
        PersonOptions(out=out, lenses="one", frames=frames, cameras=cameras, size=size, seed=seed)
    )
    return f"{out}: {result['images']} images of {size} in {result['seconds']} s"


def speeds(data: dict[str, TrainingData], gpu: str, until: float) -> list[dict[str, Any]]:
    """Steps a second of `CASES`, as many as time allows, the GPU's first."""
    rows: list[dict[str, Any]] = []
    for device in dict.fromkeys((gpu, "cpu")):
        for preset, variant, images in CASES:
            what = f"{preset} {variant} {images} {device}"
            if images not in data or (preset, device) == ("paper", "cpu"):
                continue  # a step of the paper's preset takes a CPU half a minute
            if time.monotonic() > until:
                told(f"no time for {what}")
                continue
            with reported(what):
                rows.append(timed(preset, variant, data[images], device))
                told(json.dumps(rows[-1]))
    return rows


def timed(preset: str, variant: str, data: TrainingData, device: str) -> dict[str, Any]:
    """Joint steps a second, and the losses of the first step."""
    config = replace(PRESETS[preset], variant=variant, geometry_steps=0)
    first = data.capture.cameras[0]
    with (
        tempfile.TemporaryDirectory() as folder,
        open_trainer(data, config, Path(folder), device=device) as trainer,
    ):
        losses = trainer.train_step()
        if device != "cpu":
            for step in range(HEATED):
                trainer.objectives.prepare("joint", Draw(config.seed, step))
            for _ in range(WARM_STEPS):
                trainer.train_step()
        steps, began, took_s = 0, time.perf_counter(), 0.0
        while took_s < TIMED_S:
            trainer.train_step()
            steps, took_s = steps + 1, time.perf_counter() - began
    return {
        "case": f"{preset} {variant} {first.width}x{first.height}",
        "device": device,
        "steps_a_second": round(steps / took_s, 3),
        "first_losses": losses,
    }


def train(options: argparse.Namespace, data: TrainingData, device: str, until: float) -> Curves:
    """Let the models take turns until the time is over; the curve of each."""
    path = options.out / "curves.json"
    curves: Curves = json.loads(path.read_text()) if path.exists() else {}
    with ExitStack() as stack:
        trainers: dict[str, Trainer] = {}
        for variant in VARIANTS:
            with reported(f"opening {variant}"):
                trainers[variant] = stack.enter_context(opened(options, variant, data, device))
        steps = FIRST_TURN
        while trainers and steps >= FIRST_TURN:
            began = time.monotonic()
            end = min(trainer.step for trainer in trainers.values()) + steps
            for variant, trainer in list(trainers.items()):
                goes_on = False
                with reported(variant):
                    curve = curves.setdefault(variant, [])
                    goes_on = turn(trainer, end, options.out, curve, until)
                if not goes_on:
                    del trainers[variant]
            write(path, curves)
            now = time.monotonic()
            # So that the next turns of all end in time.
            steps = min(MOST_TURN, int(steps * TURN_SHARE * (until - now) / (now - began)))
    return curves


@contextmanager
def opened(
    options: argparse.Namespace, variant: str, data: TrainingData, device: str
) -> Iterator[Trainer]:
    """A run, gone on with where it was stopped, here or on another machine."""
    config = replace(PRESETS[options.preset], variant=variant, seed=options.seed)
    with open_trainer(data, config, options.out / variant, device=device) as trainer:
        for folder in (options.out / variant, options.out / "light" / variant):
            if (folder / CHECKPOINT).exists():
                trainer.restore(folder)
                break
        yield trainer


def turn(trainer: Trainer, end: int, out: Path, curve: list[dict[str, Any]], until: float) -> bool:
    """Some steps of a run, and a point of its curve; True if there are more to do."""
    variant = trainer.config.variant
    trainer.run(lambda step, _phase, _losses: step < end and time.monotonic() < until)
    rows = evaluate(trainer, max_frames=EVAL_FRAMES, sources=("encoder",))
    found = {"steps": trainer.step, "seconds": trainer.seconds, "mse": mean_mse(rows), "rows": rows}
    curve.append(found)
    light = out / "light" / variant
    light.mkdir(parents=True, exist_ok=True)
    trainer.save(light, light=True)
    told(f"{variant}: {found['steps']} steps, {found['seconds']:.0f} s, MSE {found['mse']:.2f}")
    return trainer.step < trainer.total_steps


def speed_table(rows: list[dict[str, Any]]) -> str:
    """Steps a second, and by how much of their size the first losses differ between devices."""
    lines = ["| preset, model, images | cuda | cpu | first losses differ by |", "|---|---|---|---|"]
    for case in dict.fromkeys(row["case"] for row in rows):
        own = {row["device"]: row for row in rows if row["case"] == case}
        rates = [str(own.get(name, {}).get("steps_a_second", "–")) for name in ("cuda", "cpu")]
        one, *other = (row["first_losses"] for row in own.values())
        apart = [f"{abs(each[name] / one[name] - 1):.1e}" for each in other for name in one]
        lines.append(f"| {case} | {' | '.join(rates)} | {', '.join(apart) or '–'} |")
    return "\n".join(lines)


def curve_table(curves: Curves) -> str:
    """Held-out MSE by steps."""
    lines = [f"| steps | {' | '.join(curves)} |", "|---" * (1 + len(curves)) + "|"]
    for steps in sorted({found["steps"] for points in curves.values() for found in points}):
        at = [{found["steps"]: found["mse"] for found in points} for points in curves.values()]
        cells = [f"{each[steps]:.2f}" if steps in each else "–" for each in at]
        lines.append(f"| {steps} | {' | '.join(cells)} |")
    return "\n".join(lines)


def last_table(curves: Curves) -> str:
    """The paper's table of the last steps that all models have."""
    reached = [{found["steps"] for found in points} for points in curves.values()]
    last = max(set.intersection(*reached), default=0) if reached else 0
    at = [found for points in curves.values() for found in points if found["steps"] == last]
    rows = [row for found in at for row in found["rows"]]
    return f"After {last} steps:\n\n{error_table(rows, VARIANTS)}"


@contextmanager
def reported(what: str) -> Iterator[None]:
    """Say what failed, and go on: the rest of a borrowed machine's time is worth it."""
    try:
        yield
    except (PicaCoreError, RuntimeError, ValueError, KeyError, TypeError) as error:
        told(f"{what} failed: {type(error).__name__}: {error}")


def write(path: Path, content: Any) -> None:
    """Write JSON."""
    path.write_text(json.dumps(content, indent=1) + "\n")


def told(text: str) -> None:
    """Say something at once."""
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
