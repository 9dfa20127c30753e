"""`pica train`, `pica export`, and `pica bench claim`, which compares models on any heads."""

import json
import signal
import sys
import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from pica_core.avatar.file import avatar_id, save_avatar
from pica_core.capture.dataset.dataset import Capture
from pica_core.errors import CaptureError, TrainingError, check_ranges
from pica_core.model.avatar import PixelCodecAvatar
from pica_core.train.config import PRESETS, TrainConfig
from pica_core.train.data import TrainingData
from pica_core.train.evaluate import evaluate, mean_mse
from pica_core.train.export import EVALUATION_FILE, joint_map, make_avatar, model_card
from pica_core.train.lod.levels import add_levels
from pica_core.train.train import CHECKPOINT, Trainer, open_trainer, read_checkpoint

VariantName = Literal[
    "linear", "full", "no_uv", "coarse", "uv_nope", "nerf_pe", "pe_2d", "pe_1d", "baseline"
]


@dataclass(frozen=True, kw_only=True, slots=True)
class TrainOptions:
    """Options of `pica train`."""

    capture: Path
    """Folder of the capture (`pica capture person` makes one)."""
    out: Path
    """Folder of the run: checkpoint, metrics, held-out error."""
    variant: VariantName | None = None
    """Which model: linear, full, the baseline, or full with one part replaced (docs/training.md).
    Without it linear, and full with the preset paper."""
    preset: Literal["tiny", "small", "own", "long", "paper"] = "small"
    """How much to train: tiny (seconds), small (minutes on two cores), own (half as much again, for
    heads from scans and photos), long (two or three times that), paper (its settings to the letter;
    days on a GPU)."""
    block: Literal["H2", "G"] | None = None
    """Block of the decoders, if not the preset's."""
    encoder: Literal["light", "paper"] | None = None
    """Encoder, if not the preset's."""
    seed: int = 0
    """Seed of initial weights, batches and noise."""
    threads: int = 2
    """CPU threads of torch."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to compute; auto takes a GPU where there is one."""
    resume: bool = False
    """Go on from the run's checkpoint."""
    seconds: float = 0.0
    """Stop after so many seconds of steps, with a checkpoint, and evaluate what there is; 0 for no
    limit."""
    eval_frames: int = 25
    """Held-out frames to evaluate at the end."""

    def __post_init__(self) -> None:
        ranges = {
            "seed": (0, 2**31 - 1),
            "threads": (1, 1024),
            "seconds": (0, 1e9),
            "eval_frames": (1, 1_000_000),
        }
        check_ranges(self, TrainingError, **ranges)


@dataclass(frozen=True, kw_only=True, slots=True)
class ExportOptions:
    """Options of `pica export`."""

    run: Path
    """Folder of a finished run of `pica train`."""
    capture: Path
    """The capture that the run was trained on."""
    out: Path
    """The avatar file to write."""
    name: str
    """Name to show."""
    licence: str | None = None
    """Licence of the avatar; Apache-2.0, of a published capture the data set's."""
    levels: bool = True
    """Fit levels of detail (a minute or two). Without them far heads cost as much as near
    ones."""
    threads: int = 2
    """CPU threads of torch."""

    def __post_init__(self) -> None:
        check_ranges(self, TrainingError, threads=(1, 1024))


def train(options: TrainOptions) -> dict[str, Any]:
    """Train an avatar on a capture: geometry, then everything jointly, then its live encoder."""
    config = _config(options)
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TrainingError(f"{options.out}: cannot be made: {error.strerror or error}") from error
    torch.set_num_threads(options.threads)
    data = TrainingData(Capture.open(options.capture))
    if not options.resume and (options.out / CHECKPOINT).exists():
        raise TrainingError(f"{options.out}: a run is there already; --resume goes on with it")
    with open_trainer(data, config, options.out, device=_device(options.device)) as trainer:
        if options.resume:
            trainer.restore()
        _run_with_progress(trainer, options.seconds)
        rows = evaluate(trainer, max_frames=options.eval_frames)
        steps = trainer.step
    (options.out / EVALUATION_FILE).write_text(json.dumps(rows, indent=1) + "\n")
    result = {
        "steps": steps,
        "mse": mean_mse(rows, "encoder"),
        "driver_mse": mean_mse(rows, "driver"),
        "vertex_error_mm": rows[0]["vertex_error_mm"],
        "rows": rows,
    }
    told = f"held-out MSE (0-255, rasterised pixels): {result['mse']:.1f} by the model's encoder"
    if result["driver_mse"] is not None:
        told += f", {result['driver_mse']:.1f} from ARKit values"
    print(told, file=sys.stderr)
    return result


def export(options: ExportOptions) -> dict[str, Any]:
    """Write the avatar file of a trained run."""
    config = read_checkpoint(options.run)["config"]
    torch.set_num_threads(options.threads)
    data = TrainingData(Capture.open(options.capture))
    if not data.capture.has_expressions:
        raise CaptureError(
            f"{options.capture}: no expressions, so nothing could drive the avatar; "
            "run pica capture expressions, then train again"
        )
    theirs = str(data.capture.info["licence"])
    with open_trainer(data, config, options.run) as trainer:
        start = joint_map(trainer.model)
        trainer.restore()
        model = trainer.model
        if not isinstance(model, PixelCodecAvatar):
            raise TrainingError(f"{options.run}: a baseline is measured, and not exported")
        avatar = make_avatar(
            model,
            data,
            name=options.name,
            identity=data.capture.identity,
            licence=options.licence or (theirs if data.capture.is_published else "Apache-2.0"),
            model_card=model_card(trainer, options.run),
            start=start,
        )
        tensors = dict(avatar.tensors)
        if options.levels:
            tensors |= add_levels(avatar, show=lambda text: print(text, file=sys.stderr)).tensors
    avatar = replace(avatar, tensors=tensors)
    save_avatar(options.out, avatar)
    size = options.out.stat().st_size
    print(f"{options.out}: {size / 1e6:.2f} MB", file=sys.stderr)
    return {"path": str(options.out), "bytes": size, "id": avatar_id(options.out)}


def _device(wished: str) -> torch.device:
    """Where to compute."""
    has_gpu = torch.cuda.is_available()
    if wished == "cuda" and not has_gpu:
        raise TrainingError("device is cuda, but torch finds no GPU here; use cpu or auto")
    if wished == "cpu" or not has_gpu:
        return torch.device("cpu")
    return torch.device("cuda")


def _config(options: TrainOptions) -> TrainConfig:
    config = replace(PRESETS[options.preset], seed=options.seed)
    chosen: dict[str, Any] = {"block": options.block, "encoder": options.encoder}
    changes = {name: value for name, value in chosen.items() if value is not None}
    usual = config.variant if options.preset == "paper" else "linear"
    return replace(config, variant=options.variant or usual, **changes)


def _run_with_progress(trainer: Trainer, seconds: float) -> None:
    """Run with a bar on stderr: phase, losses, time left; stop after some seconds of steps, if they
    are not 0.

    An interrupt is taken between two steps, so that the checkpoint it leaves is whole.
    """
    interrupted, before_s = threading.Event(), trainer.seconds
    before = signal.signal(signal.SIGINT, lambda *_: interrupted.set())
    columns = (
        TextColumn("{task.description:9}"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total}"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[losses]}"),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, refresh_per_second=2) as progress:
        task = progress.add_task("", total=trainer.total_steps, completed=trainer.step, losses="")

        def show(step: int, phase: str, losses: dict[str, float]) -> bool:
            shown = "  ".join(f"{name} {value:.4f}" for name, value in losses.items())
            progress.update(task, completed=step, description=phase, losses=shown)
            is_over = seconds > 0 and trainer.seconds - before_s >= seconds
            return not interrupted.is_set() and not is_over

        try:
            trainer.run(show)
        finally:
            signal.signal(signal.SIGINT, before)
    if interrupted.is_set():
        raise KeyboardInterrupt


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
        check_ranges(self, TrainingError, seeds=(1, 100))
        for name in ("captures", "variants"):
            if not getattr(self, name):
                raise TrainingError(f"{name} is empty; name at least one")
        names = [path.name for path in self.captures]
        if twice := [name for name in names if names.count(name) > 1]:
            raise TrainingError(f"captures: two are called {twice[0]!r}; rename one")


def bench_claim(options: ClaimOptions) -> dict[str, Any]:
    """Train the default model, full and baseline on heads; count the views that it wins."""
    for capture in options.captures:  # before hours are spent on the others
        Capture.open(capture)
    rows: list[dict[str, Any]] = []
    for capture in options.captures:
        for seed in range(options.seeds):
            for variant in options.variants:
                print(f"{capture.name} {variant} {seed}", file=sys.stderr, flush=True)
                rows += _run(capture, variant, seed, options)
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
    """Rows of one run, which goes on where it was stopped, and is measured: those of `evaluate` by
    the model's encoder, with the live encoder's MSE beside."""
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
        row | {"identity": capture.name, "live_mse": live.get(row["view"])}
        for row in found
        if row["source"] == "encoder"
    ]
