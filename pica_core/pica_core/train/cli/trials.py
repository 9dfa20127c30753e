"""`pica bench recipes` and `pica bench failures`: many short runs on one capture, compared."""

import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import torch

from pica_core.capture.dataset.dataset import Capture
from pica_core.errors import TrainingOptionError, check_ranges
from pica_core.train.config import PRESETS, TrainConfig
from pica_core.train.data.training import TrainingData
from pica_core.train.trials.failures import FAILURES, run_failures
from pica_core.train.trials.recipes import RECIPES, run_recipes


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialOptions:
    """What `pica bench recipes` and `pica bench failures` have in common."""

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


def bench_recipes(options: TrialOptions) -> dict[str, Any]:
    """Train with each recipe and give held-out error against seconds of training."""

    def told(row: dict[str, Any]) -> str:
        return f"{row['recipe']} {row['seed']}: {row['seconds']:.0f} s, MSE {row['mse']:.1f}"

    return _trial(options, RECIPES, run_recipes, told)


def bench_failures(options: TrialOptions) -> dict[str, Any]:
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
    data = TrainingData(capture, config.model.spec().map_size)
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
