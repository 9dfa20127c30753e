"""`pica eval`: the paper's two tables as one from finished runs, and what stands beside, as
Markdown."""

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pica_core.avatar.spec import VARIANTS
from pica_core.capture.dataset.dataset import Capture
from pica_core.errors import TrainingError, check_ranges
from pica_core.train.config import TrainConfig
from pica_core.train.data import TrainingData
from pica_core.train.evaluate import evaluate
from pica_core.train.train import open_trainer, read_checkpoint

Row = Mapping[str, Any]
Key = tuple[str, str, str, int]
"""Identity, variant, block of the decoders ("" where there is none) and seed: a run."""
Model = tuple[str, str, str]
"""A key without its seed: runs that a table shows in one line."""

_MEANS = {
    "mse": ("MSE", 2),
    "ssim": ("SSIM", 4),
    "vertex_error_mm": ("vertices mm", 3),
    "lid_error_mm": ("lids mm", 3),
    "lip_error_mm": ("lips mm", 3),
}
_NONE = "–"


@dataclass(frozen=True, kw_only=True, slots=True)
class EvalOptions:
    """Options of `pica eval`."""

    runs: tuple[Path, ...]
    """Folders of finished runs of `pica train`."""
    frames: int = 25
    """Held-out frames to measure, evenly spaced."""
    capture: Path | None = None
    """The capture of all runs, if it is not where it was when they were trained."""
    out: Path | None = None
    """Folder for table.md and eval.json."""
    threads: int = 2
    """CPU threads of torch."""

    def __post_init__(self) -> None:
        check_ranges(self, TrainingError, frames=(1, 1_000_000), threads=(1, 1024))
        if not self.runs:
            raise TrainingError("runs is empty; name at least one folder")


def eval_runs(options: EvalOptions) -> dict[str, Any]:
    """Measure finished runs and print the paper's tables as one."""
    torch.set_num_threads(options.threads)
    states = {folder: read_checkpoint(folder) for folder in options.runs}
    configs = {folder: state["config"] for folder, state in states.items()}
    captures = {f: options.capture or Path(states[f]["capture"]) for f in options.runs}
    opened = {path: Capture.open(path) for path in captures.values()}
    _check_apart([(captures[f], opened[captures[f]].identity, f, configs[f]) for f in options.runs])
    rows: list[dict[str, Any]] = []
    for path, capture in opened.items():
        data = TrainingData(capture)
        for folder in [folder for folder in options.runs if captures[folder] == path]:
            print(f"{folder}: {configs[folder].variant}", file=sys.stderr, flush=True)
            with open_trainer(data, configs[folder], folder) as trainer:
                trainer.restore()
                rows += evaluate(trainer, max_frames=options.frames, sources=("encoder",))
    notes = sorted({str(each.info.get("source", each.path.name)) for each in opened.values()})
    result = {"captures": notes, "rows": rows}
    text = report(result)
    print(text)
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "table.md").write_text(text, encoding="utf-8")
        (options.out / "eval.json").write_text(json.dumps(result, indent=1) + "\n")
    return result


def _check_apart(runs: Sequence[tuple[Path, str, Path, TrainConfig]]) -> None:
    """Refuse what a table would show as one: two captures of one identity, two runs of one key;
    of captures, their identities, folders and options of runs."""
    captures: dict[str, Path] = {}
    folders: dict[Key, Path] = {}
    for capture, identity, folder, config in runs:
        if (other := captures.setdefault(identity, capture)) != capture:
            raise TrainingError(
                f"{other} and {capture} are two captures of {identity!r}; measure one at a time"
            )
        key = (identity, config.variant, config.block, config.seed)
        if key in folders:
            raise TrainingError(
                f"{folders[key]} and {folder} are both {config.variant} of {identity!r} with seed "
                f"{config.seed}; leave one out"
            )
        folders[key] = folder


def report(result: Mapping[str, Any]) -> str:
    """The whole report of what `pica eval` finds."""
    rows = result["rows"]
    parts = [
        "# Held-out error",
        "MSE on 0-255 values over rasterised pixels of held-out frames: the mean over "
        "seeds with the lowest and the highest of them, or of one seed with its 95 % bootstrap "
        "interval over frames. The captures' own note on what they are: "
        + "; ".join(result["captures"]),
        error_table(rows),
        "## Beside it",
        "Means over views. Distances are those of vertices from the capture's best mesh.",
        summary_table(rows),
    ]
    return "\n\n".join(parts) + "\n"


def error_table(rows: Sequence[Row]) -> str:
    """MSE by identity, model and view; the best of a view is bold.

    One seed stands with the interval over its frames, the mean of several with the lowest and the
    highest of them.
    """
    views = list(dict.fromkeys(row["view"] for row in rows))
    found: dict[tuple[Model, str], list[Row]] = {}
    for row in rows:
        found.setdefault((_key(row)[:3], row["view"]), []).append(row)
    means = {at: float(np.mean([row["mse"] for row in own])) for at, own in found.items()}

    def cell(model: Model, view: str) -> str:
        own = found.get((model, view))
        if own is None:
            return _NONE
        mean = means[model, view]
        best = min(e for (other, at), e in means.items() if other[0] == model[0] and at == view)
        value = f"**{mean:.2f}**" if mean == best else f"{mean:.2f}"
        ends = [row["mse"] for row in own]
        if len(own) == 1:
            ends = [own[0]["mse_low"], own[0]["mse_high"]]
        return f"{value} ({min(ends):.2f} to {max(ends):.2f})"

    return _table(rows, views, lambda model, _: [cell(model, view) for view in views])


def summary_table(rows: Sequence[Row]) -> str:
    """What stands beside the MSE: means over views and seeds, and what the model costs."""

    def cells(_: Model, own: Sequence[Row]) -> list[str]:
        shown = []
        for name, (_title, digits) in _MEANS.items():
            values = [row[name] for row in own if row[name] is not None]
            shown.append(f"{np.mean(values):.{digits}f}" if values else _NONE)
        first = own[0]
        return [
            *shown,
            f"{first['parameters'] / 1e6:.3f}",
            f"{first['macs'] / 1e6:.1f}",
            str(first["macs_per_pixel"]),
            str(first["steps"]),
            ", ".join(str(seed) for seed in sorted({row["seed"] for row in own})),
        ]

    head = [title for title, _ in _MEANS.values()]
    head += ["M parameters", "M multiply-adds", "a pixel", "steps", "seeds"]
    return _table(rows, head, cells)


def _key(row: Row) -> Key:
    return row["identity"], row["variant"], row.get("block") or "", row["seed"]


def _table(
    rows: Sequence[Row], head: Sequence[str], cells: Callable[[Model, Sequence[Row]], Sequence[str]]
) -> str:
    """A line for each model, by identity and in the order of `VARIANTS`: its identity, its variant
    (with its block where it has several), and its cells, made of its rows."""
    known, order = {_key(row)[:3] for row in rows}, list(VARIANTS)
    lines = [["identity", "model", *head], ["---"] * (2 + len(head))]
    for model in sorted(known, key=lambda each: (each[0], order.index(each[1]), each[2])):
        blocks = {other[2] for other in known if other[:2] == model[:2]}
        label = model[1] + (f", block {model[2]}" if len(blocks) > 1 else "")
        own = [row for row in rows if _key(row)[:3] == model]
        lines.append([model[0], label, *cells(model, own)])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
