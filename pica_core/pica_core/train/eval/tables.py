"""Rows of an evaluation as Markdown: the paper's tables, and what stands beside them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from pica_core.avatar.variants import TABLE_1, TABLE_2
from pica_core.train.eval.evaluate import bootstrap_interval
from pica_core.train.eval.run import DEPTH_CAP_MM, REGIONS

Rows = Sequence[Mapping[str, Any]]
Key = tuple[str, str, str, int]
"""Identity, variant, block of the decoders ("" where it is not told) and seed: a run."""
Model = tuple[str, str, str]
"""A key without its seed: runs that a table shows in one line."""

TABLES: Mapping[int, tuple[str, ...]] = {1: TABLE_1, 2: TABLE_2}
QUANTILES = (100, 90, 75, 50, 25, 10, 0)
_SPLITS = {"test": "held-out frames", "train": "frames that were trained on"}
_MEANS = (("mse", 2), ("psnr_db", 2), ("ssim", 4))
_TRACKED = "tracked mesh"
_NONE = "–"


def error_table(rows: Rows, variants: Sequence[str]) -> str:
    """MSE by identity, model and view; the best of a view is bold.

    One seed stands with the interval over its frames, the mean of several with the lowest and the
    highest of them.
    """
    views = list(dict.fromkeys(row["view"] for row in rows))
    cells: dict[tuple[Model, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        cells.setdefault((_key(row)[:3], row["view"]), []).append(row)
    means = {at: float(np.mean([row["mse"] for row in found])) for at, found in cells.items()}

    def cell(model: Model, view: str) -> str:
        found = cells.get((model, view))
        if found is None:
            return _NONE
        mean = means[model, view]
        best = min(e for (other, at), e in means.items() if other[0] == model[0] and at == view)
        value = f"**{mean:.2f}**" if mean == best else f"{mean:.2f}"
        ends = [row["mse"] for row in found]
        if len(found) == 1:
            ends = [found[0]["mse_low"], found[0]["mse_high"]]
        return f"{value} ({min(ends):.2f} to {max(ends):.2f})"

    models = _models(map(_key, rows), variants)
    return _table(models, views, lambda model: [cell(model, view) for view in views])


def summary_table(rows: Rows, variants: Sequence[str]) -> str:
    """What stands beside the MSE: means over views and seeds, and what the model costs."""

    def cells(model: Model) -> list[str]:
        own = [row for row in rows if _key(row)[:3] == model]
        changes = [row["temporal_mse"] for row in own if row["temporal_mse"] is not None]
        first = own[0]
        return [
            *(f"{np.mean([row[name] for row in own]):.{digits}f}" for name, digits in _MEANS),
            f"{np.mean(changes):.2f}" if changes else _NONE,
            f"{first['parameters'] / 1e6:.3f}",
            f"{first['macs'] / 1e6:.1f}",
            str(first["macs_per_pixel"]),
            str(first["steps"]),
            ", ".join(str(seed) for seed in sorted({row["seed"] for row in own})),
        ]

    head = ["MSE", "PSNR dB", "SSIM", "MSE of the change", "M parameters", "M multiply-adds"]
    return _table(_models(map(_key, rows), variants), [*head, "a pixel", "steps", "seeds"], cells)


def distribution_table(distributions: Mapping[Key, Rows], variants: Sequence[str]) -> str:
    """The mean with its interval over seeds and frames, and how errors spread over expressions:
    quantiles of the frames' MSE, each the mean over seeds."""

    def cells(model: Model) -> list[str]:
        values = _of_seeds(distributions, model)
        errors = np.array([list(of_seed.values()) for of_seed in values.values()])
        low, high = bootstrap_interval(errors)
        frames = errors.mean(0)
        shown = [f"{np.percentile(frames, quantile):.2f}" for quantile in QUANTILES]
        return [f"{frames.mean():.2f} ({low:.2f} to {high:.2f})", *shown]

    head = ["mean", "worst", *(f"{quantile} %" for quantile in QUANTILES[1:-1]), "best"]
    return _table(_models(distributions, variants), head, cells)


def geometry_table(
    geometry: Mapping[Key, Mapping[str, float | None]],
    tracked: Mapping[str, Mapping[str, float | None]],
    variants: Sequence[str],
) -> str:
    """Depth errors by region, millimetres, means over seeds; the tracked mesh's own first."""
    measured = {key: errors for key, errors in geometry.items() if errors}
    measured |= {(who, _TRACKED, "", 0): errors for who, errors in tracked.items() if errors}
    models = _models(measured, (_TRACKED, *variants))

    def cells(model: Model) -> list[str]:
        own = [errors for key, errors in measured.items() if key[:3] == model]
        shown = []
        for name in REGIONS:
            known = [value for each in own if (value := each.get(name)) is not None]
            shown.append(f"{np.mean(known):.2f}" if known else _NONE)
        return shown

    return _table([model for who in tracked for model in models if model[0] == who], REGIONS, cells)


def report(number: int, result: Mapping[str, Any]) -> str:
    """The whole report of what `pica eval` finds, as one of the paper's tables."""
    variants, rows = TABLES[number], result["rows"]
    runs = {_key(run): run for run in result["runs"]}
    distributions = {key: run["distribution"] for key, run in runs.items()}
    geometry = {key: run["geometry"] for key, run in runs.items()}
    parts = [
        f"# Table {number}",
        f"MSE on 0-255 values over rasterised pixels, {_SPLITS[result.get('split', 'test')]}: the "
        "mean over seeds with the lowest and the highest of them, or of one seed with its 95 % "
        "bootstrap interval over frames. The captures' own note on what they are: "
        + "; ".join(sorted({str(run["source"]) for run in runs.values()})),
        error_table(rows, variants),
        "## Beside it",
        "Means over views. The change is the one from a frame to the next of its take.",
        summary_table(rows, variants),
        "## Over expressions",
        "MSE over all views: the mean with its 95 % bootstrap interval over seeds and frames, and "
        "single frames, sorted.",
        distribution_table(distributions, variants),
    ]
    if any(geometry.values()):
        parts += [
            "## Geometry",
            f"Mean depth error in mm (capped at {DEPTH_CAP_MM:g} mm) against the true mesh, at "
            "pixels that both cover, by region of the true mesh.",
            geometry_table(geometry, result["tracked_mesh"], variants),
        ]
    return "\n\n".join(parts) + "\n"


def _key(row: Mapping[str, Any]) -> Key:
    return row["identity"], row["variant"], row.get("block") or "", row["seed"]


def _models(keys: Iterable[Key], variants: Sequence[str]) -> list[Model]:
    """Sort by identity, then in the table's order; variants that it does not name are left out."""
    known = {key[:3] for key in keys if key[1] in variants}
    return sorted(known, key=lambda model: (model[0], variants.index(model[1]), model[2]))


def _of_seeds(distributions: Mapping[Key, Rows], model: Model) -> dict[int, dict[str, float]]:
    """MSE of each frame by its name, for each seed of a model."""
    return {
        key[3]: {item["frame"]: item["mse"] for item in frames}
        for key, frames in sorted(distributions.items())
        if key[:3] == model
    }


def _table(
    models: Sequence[Model], head: Sequence[str], cells: Callable[[Model], Sequence[str]]
) -> str:
    """A line for each model that has cells, which follow its identity and its variant, with its
    block where it has several."""
    lines = [["identity", "model", *head], ["---"] * (2 + len(head))]
    for model in models:
        if found := cells(model):
            blocks = {other[2] for other in models if other[:2] == model[:2]}
            label = model[1] + (f", block {model[2]}" if len(blocks) > 1 else "")
            lines.append([model[0], label, *found])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
