"""`pica eval`: the paper's tables from finished runs."""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch

from pica_core.capture.dataset.dataset import Capture
from pica_core.errors import TrainingOptionError, check_ranges
from pica_core.train.eval.run import EvalLimits, Run, measure, open_run, prepare
from pica_core.train.eval.tables import TABLES, Key, report


@dataclass(frozen=True, kw_only=True, slots=True)
class EvalOptions(EvalLimits):
    """Options of `pica eval`: what is measured of which runs, and where it goes."""

    runs: tuple[Path, ...]
    """Folders of finished runs of `pica train`."""
    table: Literal[1, 2] = 1
    """Which of the paper's tables: 1 is baseline, full, no_uv and coarse; 2 the encodings."""
    capture: Path | None = None
    """The capture of all runs, if it is not where it was when they were trained."""
    out: Path | None = None
    """Folder for table.md and eval.json."""
    threads: int = 2
    """CPU threads of torch."""

    def __post_init__(self) -> None:
        EvalLimits.__post_init__(self)
        check_ranges(self, TrainingOptionError, threads=(1, 1024))
        if not self.runs:
            raise TrainingOptionError("runs is empty; name at least one folder")


def eval_runs(options: EvalOptions) -> dict[str, Any]:
    """Measure finished runs and print one of the paper's tables."""
    torch.set_num_threads(options.threads)
    runs = [open_run(folder, options.capture) for folder in options.runs]
    wanted = [run for run in runs if run.variant in TABLES[options.table]]
    for run in runs:
        if run.variant not in TABLES[options.table]:
            _say(f"{run.folder}: {run.variant} is no row of table {options.table}; left out")
    if not wanted:
        rows = ", ".join(TABLES[options.table])
        raise TrainingOptionError(f"no run is of table {options.table}: its models are {rows}")
    _check_apart(wanted)
    result = _measure(wanted, options)
    text = report(options.table, result)
    print(text)
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "table.md").write_text(text, encoding="utf-8")
        (options.out / "eval.json").write_text(json.dumps(result, indent=1) + "\n")
    return result


def _check_apart(runs: Sequence[Run]) -> None:
    """Refuse what a table would show as one: two captures of one identity, two runs of one key."""
    identities = {capture: Capture.open(capture).identity for capture in {r.capture for r in runs}}
    captures: dict[str, Path] = {}
    folders: dict[Key, Path] = {}
    for run in runs:
        identity = identities[run.capture]
        if (other := captures.setdefault(identity, run.capture)) != run.capture:
            raise TrainingOptionError(
                f"{other} and {run.capture} are two captures of {identity!r}; measure one at a time"
            )
        key = (identity, run.variant, run.block or "", run.config.seed)
        if key in folders:
            raise TrainingOptionError(
                f"{folders[key]} and {run.folder} are both {run.variant} of {identity!r} with seed "
                f"{run.config.seed}; leave one out"
            )
        folders[key] = run.folder


def _measure(runs: Sequence[Run], options: EvalOptions) -> dict[str, Any]:
    rows: list[dict[str, Any]] = []
    found: list[dict[str, Any]] = []
    tracked: dict[str, dict[str, float | None]] = {}
    for capture in dict.fromkeys(run.capture for run in runs):
        _say(f"{capture}: drawing the truth")
        truth = prepare(capture, options)
        tracked[truth.identity] = truth.tracked_mm
        for run in [run for run in runs if run.capture == capture]:
            own_rows, result = measure(run, truth, _say)
            rows += own_rows
            found.append(result)
    return {
        "table": options.table,
        "split": options.split,
        "rows": rows,
        "runs": found,
        "tracked_mesh": tracked,
    }


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
