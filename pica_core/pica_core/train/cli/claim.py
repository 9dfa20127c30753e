"""`pica bench claim`: the default model beside `full` and `baseline`, on any heads."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pica_core.capture.dataset.dataset import Capture
from pica_core.errors import TrainingOptionError, check_ranges
from pica_core.train.cli.train import TrainOptions, VariantName, train
from pica_core.train.train import CHECKPOINT

OURS, THEIRS = "linear", "baseline"
"""What is claimed to lie below what."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ClaimOptions:
    """Options of `pica bench claim`."""

    captures: tuple[Path, ...]
    """Captures of heads."""
    out: Path = Path("claim")
    """Folder of runs. What is finished there is measured again and not made again, and what was
    stopped goes on."""
    variants: tuple[VariantName, ...] = ("linear", "full", "baseline")
    """Models to train, rows of docs/training.md."""
    preset: Literal["tiny", "small", "long"] = "small"
    """How much to train."""
    seeds: int = 2
    """Runs of each model on each head, of seeds 0, 1, ..."""
    eval_frames: int = 25
    """Held-out frames to measure on."""
    threads: int = 1
    """CPU threads of torch."""

    def __post_init__(self) -> None:
        check_ranges(self, TrainingOptionError, seeds=(1, 100))
        for name in ("captures", "variants"):
            if not getattr(self, name):
                raise TrainingOptionError(f"{name} is empty; name at least one")
        names = [path.name for path in self.captures]
        if twice := [name for name in names if names.count(name) > 1]:
            raise TrainingOptionError(f"captures: two are called {twice[0]!r}; rename one")


def bench_claim(options: ClaimOptions) -> dict[str, Any]:
    """Train the default model, full and baseline on heads; count the views that it wins."""
    for capture in options.captures:  # before hours are spent on the others
        Capture.open(capture)
    rows: list[dict[str, Any]] = []
    for capture in options.captures:
        for seed in range(options.seeds):
            for variant in options.variants:
                made = _run(capture, variant, seed, options)
                rows += made
                mean, live, vertex_mm = (
                    _mean([row[name] for row in made]) for name in ("mse", "live_mse", "vertex_mm")
                )
                told = f"MSE {mean:.1f}" + ("" if live is None else f", live {live:.1f}")
                told += f", vertices {vertex_mm:.3f} mm, {made[0]['seconds']:.0f} s"
                print(f"{capture.name} {variant} {seed}: {told}", file=sys.stderr, flush=True)
    below = views_below(rows)
    summary = {"views_below": sum(below), "views": len(below)}
    print(f"{OURS} below {THEIRS}: {sum(below)} of {len(below)} views", file=sys.stderr)
    return {"preset": options.preset, "rows": rows, "summary": summary}


def views_below(rows: list[dict[str, Any]]) -> list[bool]:
    """Whether the default model lies below the baseline, for each identity, seed and view that both
    were measured in."""
    errors = {(r["variant"], r["identity"], r["seed"], r["view"]): r["mse"] for r in rows}
    views = [key[1:] for key in errors if key[0] == OURS and (THEIRS, *key[1:]) in errors]
    return [errors[OURS, *view] < errors[THEIRS, *view] for view in views]


def _run(
    capture: Path, variant: VariantName, seed: int, options: ClaimOptions
) -> list[dict[str, Any]]:
    """Rows of one run, which goes on where it was stopped, and is measured."""
    folder = options.out / f"{capture.name}-{variant}-{seed}"
    found = train(
        TrainOptions(
            capture=capture,
            out=folder,
            variant=variant,
            preset=options.preset,
            seed=seed,
            resume=(folder / CHECKPOINT).exists(),
            eval_frames=options.eval_frames,
            threads=options.threads,
        )
    )["rows"]
    live = {row["view"]: row["mse"] for row in found if row["source"] == "driver"}
    return [
        {
            "identity": capture.name,
            "variant": variant,
            "seed": seed,
            "view": row["view"],
            "mse": row["mse"],
            "live_mse": live.get(row["view"]),
            "vertex_mm": row["vertex_error_mm"],
            "lid_mm": row["lid_error_mm"],
            "lip_mm": row["lip_error_mm"],
            "seconds": row["seconds"],
            "steps": row["steps"],
        }
        for row in found
        if row["source"] == "encoder"
    ]


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None
