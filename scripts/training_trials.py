"""Short trainings on one capture, compared: recipes, runs spoilt on purpose, and a step's time.

    python scripts/training_trials.py recipes  --capture captures/S1 [--names as_is block_C]
    python scripts/training_trials.py failures --capture captures/S1 --seeds 3
    python scripts/training_trials.py steps    --capture captures/S1 --preset small --threads 2

The last line of stdout is the result, one JSON object. A curve of error against seconds is honest
only if nothing else ran on the machine. Results stand in docs/training.md.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
import tyro
from torch.profiler import ProfilerActivity, profile
from training_failures import FAILURES, curve, run_failures

from pica_core.capture.dataset.dataset import Capture
from pica_core.errors import TrainingOptionError, check_ranges
from pica_core.train.config import PAPER_LOSSES, PRESETS, TrainConfig
from pica_core.train.data.training import TrainingData
from pica_core.train.loop import Trainer, open_trainer

PARTS = ("data", "encode", "decode", "raster", "pixel", "loss", "backward", "optimiser")
"""Parts of a step as training names them to the profiler. "raster" holds ids, choice of pixels and
interpolation, "pixel" the appearance's lookup and the pixel decoder, "decode" both per-object
decoders."""

Recipe = Callable[[TrainConfig], TrainConfig]


def _large_batches(config: TrainConfig) -> TrainConfig:
    schedule = config.schedule
    changes = {
        "geometry_batch": 4 * schedule.geometry_batch,
        "geometry_steps": schedule.geometry_steps // 4,
        "joint_batch": 2 * schedule.joint_batch,
        "joint_steps": schedule.joint_steps // 2,
    }
    return config.changed(schedule=changes)


def _all_at_once(config: TrainConfig) -> TrainConfig:
    schedule = config.schedule
    steps = schedule.joint_steps + schedule.geometry_steps // 3
    return config.changed(schedule={"geometry_steps": 0, "joint_steps": steps})


def _change(**parts: dict[str, Any]) -> Recipe:
    return lambda config: config.changed(**parts)


RECIPES: dict[str, Recipe] = {
    "as_is": lambda config: config,
    "block_C": _change(model={"block": "C"}),
    "block_H2": _change(model={"block": "H2"}),
    "large_batches": _large_batches,
    "no_texture_at_start": _change(model={"texture_contrast": 0.0}),
    "all_at_once": _all_at_once,
    "all_vertices_alike": _change(losses={"region_weight": 1.0, "lid_weight": 1.0}),
    "all_frames_alike": _change(schedule={"frame_balance": 0.0}),
    "papers_start": _change(model={"encoding_amplitude": 1.0, "texture_contrast": 0.0}),
    "papers_rates": _change(
        schedule={
            **dict.fromkeys(("joint_rate", "pixel_rate", "encoding_rate"), 1e-3),
            "constant_rate": True,
        }
    ),
    "six_losses": _change(
        losses={name: getattr(PAPER_LOSSES, name) for name in ("depth", "normal", "smooth")}
    ),
    "kl_4_times": lambda config: config.changed(losses={"kl": 4 * config.losses.kl}),
    "all_pixels": _change(schedule={"pixels_per_image": 0}),
    "tracked_meshes": lambda config: replace(config, mesh_source="tracked"),
    **{name: _change(model={"variant": name}) for name in ("linear", "baseline")},
}
"""all_at_once takes about the same time: a step without images costs a third of one with them."""


def run_recipes(
    data: TrainingData,
    config: TrainConfig,
    folder: Path,
    names: Iterable[str] = tuple(RECIPES),
    seeds: Iterable[int] = (0,),
) -> Iterator[dict[str, Any]]:
    """Train each recipe and give the points of its curve.

    Args:
        data: The capture.
        config: The preset that recipes change; `watch_every` says how dense the curves are.
        folder: Runs go into folders of their own.
        names: Keys of `RECIPES`.
        seeds: Of weights and batches.

    Yields:
        Rows of {recipe, seed, step, seconds, mse}: held-out error after so many seconds of steps.
    """
    for name in names:
        for seed in seeds:
            run = folder / f"{name}-{seed}"
            with open_trainer(data, replace(RECIPES[name](config), seed=seed), run) as trainer:
                trainer.run()
            for point in curve(run):
                yield {"recipe": name, "seed": seed, **point}


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialOptions:
    """What `recipes` and `failures` have in common."""

    capture: Path
    """Folder of the capture."""
    names: tuple[str, ...] = ()
    """Which ones; all without it."""
    preset: Literal["tiny", "small", "long"] = "small"
    """What each run changes one thing of."""
    share: float = 1.0
    """Part of the preset's steps that is trained, of each phase."""
    looks: int = 12
    """Looks at held-out frames during a run: the points of its curve."""
    seeds: int = 1
    """Runs of each, of seeds 0, 1, ..."""
    out: Path | None = None
    """Folder to keep the runs in, with pictures; without it they are thrown away."""
    threads: int = 1
    """CPU threads of torch."""

    def __post_init__(self) -> None:
        check_ranges(self, TrainingOptionError, looks=(1, 1000), seeds=(1, 100), threads=(1, 1024))
        if not 0 < self.share <= 10:
            raise TrainingOptionError(f"share is {self.share}; above 0, at most 10 is allowed")

    def chosen(self, known: Iterable[str]) -> tuple[str, ...]:
        """The names, checked.

        Raises:
            TrainingOptionError: One that there is not.
        """
        every = tuple(known)
        unknown = [name for name in self.names if name not in every]
        if unknown:
            raise TrainingOptionError(f"names: no {unknown[0]!r}; known are {', '.join(every)}")
        return self.names or every

    def config(self) -> TrainConfig:
        """The preset, shortened, without the driver phase, which changes no picture."""
        preset = PRESETS[self.preset]
        geometry, joint, _ = (round(self.share * steps) for steps in preset.schedule.steps)
        schedule = replace(
            preset.schedule, geometry_steps=geometry, joint_steps=joint, driver_steps=0
        )
        return replace(
            preset, schedule=schedule, watch_every=max(1, (geometry + joint) // self.looks)
        )


def recipes(options: TrialOptions) -> dict[str, Any]:
    """Train with each recipe and give held-out error against seconds of training."""

    def told(row: dict[str, Any]) -> str:
        return f"{row['recipe']} {row['seed']}: {row['seconds']:.0f} s, MSE {row['mse']:.1f}"

    return _trial(options, RECIPES, run_recipes, told)


def failures(options: TrialOptions) -> dict[str, Any]:
    """Spoil runs on purpose and say what comes of it."""

    def told(row: dict[str, Any]) -> str:
        end = "diverged" if row["diverged"] else f"MSE {row['mse']:.1f}"
        return f"{row['failure']} {row['seed']}: {end}"

    return _trial(options, FAILURES, run_failures, told)


def _trial(
    options: TrialOptions,
    known: Iterable[str],
    run: Callable[..., Iterator[dict[str, Any]]],
    told: Callable[[dict[str, Any]], str],
) -> dict[str, Any]:
    """Do the runs that are asked for, saying of each row what `told` makes of it."""
    names, config = options.chosen(known), options.config()
    torch.set_num_threads(options.threads)
    capture = Capture.open(options.capture)
    data = TrainingData(capture)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for row in run(data, config, options.out or Path(folder), names, range(options.seeds)):
            rows.append(row)
            print(told(row), file=sys.stderr)
    return {
        "identity": str(capture.info.get("head", capture.path.name)),
        "frames": len(capture.frames),
        "cameras": len(capture.cameras),
        "preset": options.preset,
        "share": options.share,
        "threads": options.threads,
        "rows": rows,
    }


@dataclass(frozen=True, kw_only=True, slots=True)
class StepOptions:
    """Options of `steps`."""

    capture: Path
    """Folder of the capture."""
    preset: Literal["tiny", "small", "long", "paper"] = "small"
    """Whose joint phase to measure."""
    six_losses: bool = False
    """Measure with all six losses of the paper, whatever the preset has."""
    steps: int = 20
    """Steps to measure, after five to warm up."""
    threads: int = 2
    """CPU threads of torch."""


def steps(options: StepOptions) -> dict[str, Any]:
    """Say where the time of a training step goes. Weights are thrown away."""
    torch.set_num_threads(options.threads)
    config = PRESETS[options.preset]
    losses = PAPER_LOSSES if options.six_losses else config.losses
    schedule = replace(config.schedule, geometry_steps=0, joint_steps=options.steps + 10)
    config = replace(config, losses=losses, schedule=schedule)
    data = TrainingData(Capture.open(options.capture))
    with (
        tempfile.TemporaryDirectory() as folder,
        open_trainer(data, config, Path(folder)) as trainer,
    ):
        row = time_steps(trainer, options.steps)
    for name in ("step", *PARTS):
        low, middle, high = (row[f"{name}{which}_ms"] for which in ("_low", "", "_high"))
        print(f"{name:10}{middle:8.1f} ms  ({low:.1f} to {high:.1f})", file=sys.stderr)
    return {"preset": options.preset, "threads": options.threads, "steps": options.steps, **row}


def time_steps(trainer: Trainer, steps: int, *, warm_up: int = 5) -> dict[str, Any]:
    """Do some steps under torch's profiler and say where their time went.

    Args:
        trainer: Whose current phase is measured; its steps count as trained.
        steps: Measured ones.
        warm_up: Steps before, in which buffers grow; textures and meshes are read before them.

    Returns:
        ``{part}_ms`` for each of `PARTS` and ``step_ms``: medians; ``{...}_low_ms`` and
        ``{...}_high_ms``: quartiles. "step" holds what no part does, too. With a GPU the times of
        parts are those of handing the work over.
    """
    with torch.no_grad():  # a run reads each texture and mesh once
        for frame in trainer.data.train_frames:
            trainer.objectives.encode([frame])
    for _ in range(warm_up):
        trainer.train_step()
    found: dict[str, list[float]] = {name: [] for name in (*PARTS, "step")}
    for _ in range(steps):
        with profile(activities=[ProfilerActivity.CPU]) as profiler:
            started = time.perf_counter()
            trainer.train_step()
            found["step"].append(1000 * (time.perf_counter() - started))
        by_name = {row.key: row.cpu_time_total for row in profiler.key_averages()}
        for part in PARTS:
            found[part].append(by_name.get(part, 0.0) / 1000)
    row: dict[str, Any] = {}
    for name, values in found.items():
        low, middle, high = np.percentile(values, (25, 50, 75))
        row |= {f"{name}_ms": middle, f"{name}_low_ms": low, f"{name}_high_ms": high}
    return row


def main(words: list[str] | None = None) -> None:
    """Run one kind of trial."""
    kinds: dict[str, Callable[..., Any]] = {
        "recipes": recipes,
        "failures": failures,
        "steps": steps,
    }
    config = (tyro.conf.OmitArgPrefixes,)
    found: Any = tyro.extras.subcommand_cli_from_dict(kinds, args=words, config=config)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
